"""The commands that act on one device by hand."""
