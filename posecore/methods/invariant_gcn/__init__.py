"""Poses of things never seen, from their kind: features that do not turn, and graph convolution."""
