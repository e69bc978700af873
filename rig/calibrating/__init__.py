"""Photos of boards and levels, and what follows from them for a capture."""
