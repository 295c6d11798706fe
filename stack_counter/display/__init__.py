# SPDX-License-Identifier: Apache-2.0
"""Meshes, drawings and reports for people; knows no ROS."""
