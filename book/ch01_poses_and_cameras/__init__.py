"""Chapter 1, poses and cameras."""
