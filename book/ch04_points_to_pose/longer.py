"""At the book's sizes: with twice as many steps, and plain regression on pictures."""

from __future__ import annotations

from collections.abc import Iterable

from book.ch04_points_to_pose import cloud_sources as sources
from book.ch04_points_to_pose import estimated_race, runs
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose.runs import Run
from book.tools.checkpoints import resume_folder
from book.tools.keys import Key

__all__ = ["RUNS", "measure_bins", "measure_p2p", "measure_p2r", "measure_regression"]

RUNS = {
    "p2p longer, book": Run("p2p", book=True, steps=2.0),
    "p2r longer, book": Run("p2r", book=True, steps=2.0),
    "bins longer, book": Run("bins", book=True, steps=2.0),
    "regression, book": Run("regression", book=True),
}
"""By name, as of `runs.RUNS`."""


def train_longer(name: str, seed: int) -> training.Trained:
    """Train one of `RUNS`."""
    run = RUNS[name]
    folder = resume_folder(train_longer, name, seed, data=("headset/crowd",))
    return training.train(run.method, runs.recipe_of(run), seed, views=run.views, folder=folder)


def _measure(own: Iterable[str], others: Iterable[str], seed: int) -> dict[Key, float]:
    """Of these runs, and of some of `runs.RUNS` beside them."""
    values: dict[Key, float] = {}
    for name in own:
        trained = train_longer(name, seed)
        values |= runs.measured(name, training.measure(trained, seed=seed))
    for name in others:
        trained = runs.train_run(name, seed, keep=True)
        values |= runs.measured(name, runs.test_run(name, trained, seed))
    return values


def measure_p2p(seed: int) -> dict[Key, float]:
    """P2P with 4000 steps beside its 2000, and CloudPose with its most."""
    others = ("p2p, book", "cloudpose, book", "cloudpose longer, book")
    return _measure(("p2p longer, book",), others, seed)


def measure_p2r(seed: int) -> dict[Key, float]:
    """P2R with 4000 steps beside its 2000."""
    return _measure(("p2r longer, book",), ("p2r, book",), seed)


def measure_bins(seed: int) -> dict[Key, float]:
    """RandomizedBins with 4000 steps beside its 2000."""
    return _measure(("bins longer, book",), ("bins, book",), seed)


def measure_regression(seed: int) -> dict[Key, float]:
    """Plain regression on pictures beside RandomizedBins, and P2P on true and estimated clouds."""
    values = _measure(("regression, book",), ("bins, book", "p2p, book"), seed)
    name = "p2p, estimated, book"
    trained = estimated_race.train_estimated(name, seed)
    return values | runs.measured(name, training.measure(trained, sources.estimated, seed))
