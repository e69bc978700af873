"""How good the photos are, while they are taken."""
