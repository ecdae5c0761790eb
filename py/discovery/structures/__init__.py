"""Structures: the base with effects added, what is known of each, and which is tried next."""
