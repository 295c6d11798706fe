"""Simulated scenes: containers, truth, ray casting and storage."""
