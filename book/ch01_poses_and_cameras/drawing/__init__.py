"""Figures of chapter 1, poses and cameras."""
