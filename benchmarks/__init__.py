"""Performance and accuracy, side by side with peers; each file prints its tables."""
