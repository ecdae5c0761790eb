"""Polynomial difference equations whose terms are selected one after the other (NARX)."""
