"""A simulated laboratory: optics of its own, simulated devices, emulators that speak the wire."""
