"""Plan and run captures: the only package that composes the others."""
