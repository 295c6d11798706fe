# SPDX-License-Identifier: Apache-2.0
"""Pictures without poses become a bag: poses by structure from motion, scale by a reference."""
