"""Metrics of the whole method on simulated and real recordings."""
