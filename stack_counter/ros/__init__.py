# SPDX-License-Identifier: Apache-2.0
"""What everything that imports rclpy shares: node lifecycle, message conversion, processes."""
