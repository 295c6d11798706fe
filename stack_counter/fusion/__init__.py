"""Depth views become one surface: region of interest, levelling, TSDF."""
