"""Fits: one structure led from the start that its user gave through growing windows to whole recordings."""
