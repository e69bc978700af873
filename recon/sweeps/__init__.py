"""From the photos of a sweep to the place that each pixel sees, with its standard deviation."""
