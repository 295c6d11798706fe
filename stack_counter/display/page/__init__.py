# SPDX-License-Identifier: Apache-2.0
"""The report of one count as one page that opens anywhere, with its 3D model."""
