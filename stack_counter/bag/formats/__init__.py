# SPDX-License-Identifier: Apache-2.0
"""Files that recordings come in: mcap, sqlite3 and ROS 1, each also compressed as a whole."""
