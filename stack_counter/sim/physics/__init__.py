"""Simulated physics: what falls where."""
