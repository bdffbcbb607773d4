"""Chapter 04: Points to pose."""
