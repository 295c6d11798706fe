"""Simulated cameras and recordings of simulated scenes."""
