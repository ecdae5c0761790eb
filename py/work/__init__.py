"""Work: where jobs run, what is remembered of them, how far they are."""
