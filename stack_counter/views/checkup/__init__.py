# SPDX-License-Identifier: Apache-2.0
"""Why nothing comes: what cameras and TF say, summed up, and what keeps it from a count. No ROS.

`stack-counter doctor` and `stack-counter info` show it, of a bag or of the live graph.
"""
