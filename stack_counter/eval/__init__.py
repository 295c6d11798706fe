"""Metrics and reports: how far V, gamma and counts are off on simulated and real scans."""
