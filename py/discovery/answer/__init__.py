"""The answer of a search: what is missing, how sure that is, and everything that shows it."""
