"""A characteristic of straight lines."""
