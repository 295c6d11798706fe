"""Depth and hulls from colour pictures and label images alone."""
