"""How fast correspondence is, beside decoding alone and beside scripts that a person would write first."""
