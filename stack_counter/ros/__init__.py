"""What everything that imports rclpy shares: node lifecycle, message conversion, processes."""
