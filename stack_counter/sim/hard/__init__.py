# SPDX-License-Identifier: Apache-2.0
"""Scans that are made hard on purpose, as real cells give them: one module an idea."""
