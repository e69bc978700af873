"""From places on the display to first entry points and normals."""
