"""Geometrical optics of the simulator: solids, refraction, media, rays and screens; written apart from ``recon``."""
