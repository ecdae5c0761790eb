"""Gaussian processes: one, or two in a row; trained exactly, deployed compressed."""
