"""Chapter 5, learnable rotations."""
