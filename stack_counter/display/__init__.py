"""Meshes, drawings and reports for people; knows no ROS."""
