# SPDX-License-Identifier: Apache-2.0
"""The three ROS 2 nodes: parameters in, messages to core types, core calls, messages out."""
