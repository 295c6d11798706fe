# SPDX-License-Identifier: Apache-2.0
"""Marks in the first view label every view, by poses and colour models."""
