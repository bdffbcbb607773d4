"""Figures of chapter 2, three small worlds."""
