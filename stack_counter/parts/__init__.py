# SPDX-License-Identifier: Apache-2.0
"""What is known of one part, and what that tells about gamma."""
