"""Networks trained on their free run."""
