# SPDX-License-Identifier: Apache-2.0
"""Published packings of real things, simulated as they were made."""
