"""Captures in the simulator: the world, the emulated rig, the scene as a configuration."""
