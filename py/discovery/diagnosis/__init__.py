"""Diagnosis: where a model disagrees, what is left without a name, and what to record next."""
