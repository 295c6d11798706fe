# SPDX-License-Identifier: Apache-2.0
"""Depth and hulls from colour pictures and label images alone."""
