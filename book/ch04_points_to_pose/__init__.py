"""Chapter 04: From a cloud to a pose."""
