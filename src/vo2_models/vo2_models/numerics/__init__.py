"""Numerical machinery that knows no physics: compiled kernels and their cache."""
