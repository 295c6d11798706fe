"""The three ROS 2 nodes: parameters in, messages to core types, core calls, messages out."""
