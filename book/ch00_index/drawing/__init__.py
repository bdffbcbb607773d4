"""Figures of the index."""
