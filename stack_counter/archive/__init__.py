# SPDX-License-Identifier: Apache-2.0
"""Counts every recording of an archive again: a bag a task, a row a count, nothing twice."""
