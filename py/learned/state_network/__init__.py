"""Networks with hidden states, started by an encoder."""
