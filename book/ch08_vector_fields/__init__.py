"""Chapter 8, vector fields."""
