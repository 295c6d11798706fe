# SPDX-License-Identifier: Apache-2.0
"""Training inputs: rendered, fused and degraded surfaces."""
