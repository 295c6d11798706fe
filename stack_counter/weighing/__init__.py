# SPDX-License-Identifier: Apache-2.0
"""A scale under the container: its readings, and counts by weight joined with those by vision."""
