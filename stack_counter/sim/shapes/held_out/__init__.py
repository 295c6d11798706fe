"""Families of shapes that no training scene holds."""
