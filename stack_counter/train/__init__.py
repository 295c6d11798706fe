"""Fits what says gamma on simulated piles."""
