# SPDX-License-Identifier: Apache-2.0
"""Families of shapes besides the 48 training families.

Compound and sparse parts for further training sets, and the unseen ones, on which nothing is ever
trained.
"""
