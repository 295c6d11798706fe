# SPDX-License-Identifier: Apache-2.0
"""Depth views become one surface: region of interest, levelling, TSDF."""
