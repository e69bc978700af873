"""The liquid: what is where, what must not be done, and how it is moved."""
