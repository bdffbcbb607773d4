"""Chapter 2, three small worlds."""
