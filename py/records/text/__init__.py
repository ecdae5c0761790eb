"""Text files of numbers, as loggers and spreadsheets write them."""
