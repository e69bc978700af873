"""The parts of a reconstruction that :mod:`recon.run` puts in order."""
