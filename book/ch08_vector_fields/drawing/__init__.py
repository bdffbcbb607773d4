"""Figures of chapter 8, vector fields."""
