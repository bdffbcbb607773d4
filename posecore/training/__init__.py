"""Training: one loop for every network of the book, which can be killed and goes on bit for bit."""

from posecore.randomness import seeded
from posecore.training import machine, origins
from posecore.training.checkpoints import Checkpoints
from posecore.training.feed import Feed
from posecore.training.history import History
from posecore.training.loop import fit
from posecore.training.muon import Muon, orthogonal

__all__ = [
    "Checkpoints",
    "Feed",
    "History",
    "Muon",
    "fit",
    "machine",
    "origins",
    "orthogonal",
    "seeded",
]
