"""Chapter 4: from a cloud of points to a pose."""
