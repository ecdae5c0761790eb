"""Formulas found by genetic programming, chosen and refitted on their free run."""
