"""Chapter 03: Infrared to clouds."""
