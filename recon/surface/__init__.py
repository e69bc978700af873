"""From points and normals on the camera grid to a surface: integration, fusion, mesh and its files."""
