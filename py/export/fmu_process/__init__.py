"""What runs in a process of its own: code that calls into somebody else's shared library."""
