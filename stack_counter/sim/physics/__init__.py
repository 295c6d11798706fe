# SPDX-License-Identifier: Apache-2.0
"""Simulated physics: what falls where."""
