"""The liquid's refractive index: from a table of water, as stated, or measured by the session itself."""
