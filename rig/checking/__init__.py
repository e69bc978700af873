"""What `rig doctor` looks at."""
