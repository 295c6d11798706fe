# SPDX-License-Identifier: Apache-2.0
"""Errors of the pipeline and its parts, measured on simulated scenes: `stack-counter evaluate`."""
