"""At the book's sizes, on the clouds that chapter 3's network makes of pictures."""

from __future__ import annotations

from book.ch04_points_to_pose import cloud_sources as sources
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose import runs
from book.ch04_points_to_pose.runs import Run
from book.tools.checkpoints import resume_folder
from book.tools.keys import Key

__all__ = ["ESTIMATOR", "RUNS", "measure"]

ESTIMATOR = "cloud estimator"
"""The translation that chapter 3's network says; in the paper it is P2R's."""
RUNS = {
    "p2p, estimated, book": Run("p2p", source="estimated", book=True),
    "cloudpose, estimated, book": Run("cloudpose", source="estimated", book=True),
}
"""By name, as of `runs.RUNS`."""


def train_estimated(name: str, seed: int) -> training.Trained:
    """Train one of `RUNS`."""
    run = RUNS[name]
    folder = resume_folder(train_estimated, name, seed, data=("headset/crowd",))
    return training.train(
        run.method, runs.recipe_of(run), seed, views=run.views, source=sources.estimated,
        folder=folder,
    )  # fmt: skip


def measure(seed: int) -> dict[Key, float]:
    """What these runs err, and how far off the cloud estimator's own translation is."""
    found = sources.estimated_places(training.TEST)
    places = runs.measured(ESTIMATOR, found)
    values = {k: value for k, value in places.items() if k.metric.startswith("position")}
    for name in RUNS:
        trained = train_estimated(name, seed)
        values |= runs.measured(name, training.measure(trained, sources.estimated, seed))
    return values
