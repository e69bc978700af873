"""Sessions in: what the photos mean, what happened, and files that last."""
