# SPDX-License-Identifier: Apache-2.0
"""What several evaluations share: cases, metrics, plots."""
