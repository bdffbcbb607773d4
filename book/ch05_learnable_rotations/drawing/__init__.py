"""Figures of chapter 5, learnable rotations."""
