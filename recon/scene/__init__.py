"""The scene at rest: what moved between reference photos, and what it costs."""
