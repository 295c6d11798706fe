"""Marks in the first view label every view, by poses and colour models."""
