# SPDX-License-Identifier: Apache-2.0
"""Camera messages and transforms become posed views."""
