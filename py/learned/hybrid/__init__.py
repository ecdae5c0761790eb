"""An identified model and a network for what it lacks."""
