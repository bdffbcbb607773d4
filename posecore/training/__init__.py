"""Training: one loop for every network of the book, which can be killed and goes on bit for bit."""

from posecore.randomness import seeded
from posecore.training.history import History
from posecore.training.loop import fit

__all__ = ["History", "fit", "seeded"]
