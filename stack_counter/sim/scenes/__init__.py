# SPDX-License-Identifier: Apache-2.0
"""Simulated scenes: containers, truth, ray casting and storage."""
