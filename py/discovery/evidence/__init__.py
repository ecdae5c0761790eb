"""Evidence: what a fit leaves, as one score; what the scores of all structures say together."""
