"""Three small worlds in place of data that nobody can download: headset, tabletop, categories."""
