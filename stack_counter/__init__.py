# SPDX-License-Identifier: Apache-2.0
"""Counts identical parts stacked in a bin: count = gamma * V / v (Dumery et al., ICCV 2025)."""

__version__ = "0.1.0"
