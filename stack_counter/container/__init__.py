# SPDX-License-Identifier: Apache-2.0
"""The container of a stack: its rim and walls, fitted, configured or taught."""
