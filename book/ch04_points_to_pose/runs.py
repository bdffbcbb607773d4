"""What is trained for chapter 4's ledger, and what is measured of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from book.ch04_points_to_pose import cloud_sources as sources
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose.pose_training import TEST, Source, Tested, Trained, Views
from book.tools.checkpoints import resume_folder
from book.tools.keys import Key
from data_tools.shapes import GLASSES
from posecore.methods.points_to_pose.evaluation import AXES, PoseErrors
from posecore.nets.pointnet2 import Abstraction
from posecore.scale import choose, scale

__all__ = ["EXTREME", "LONGER", "RUNS", "Run", "extreme", "key", "measured", "train_run"]

EXTREME = 40.0
"""Degrees of yaw from which a pose is called extreme."""
LONGER = 2.3
"""How many steps CloudPose makes in the time of one of P2P's, at the book's sizes."""
EVERYTHING = Views()


@dataclass(frozen=True)
class Run:
    """One training.

    Attributes:
        method: one of `pose_training.METHODS`.
        changes: of the recipe.
        views: of the crowd that it learns from.
        source: of its clouds, in training and test: "visible", "estimated", "cut", "seen",
            "crossed".
        book: whether it has the book's sizes, in place of the smaller ones.
        steps: share of the recipe's.
        size: of the glasses; 0 for the world as it is.
    """

    method: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    views: Views = EVERYTHING
    source: str = "visible"
    book: bool = False
    steps: float = 1.0
    size: float = 0.0


def _layers(neighbours: int) -> dict[str, Any]:
    """The last abstraction's ball holds the whole head; it looks at so many of its 32 points."""
    if scale() == "tiny":
        return {}
    *before, last = training.SMALL_LAYERS
    return {"layers": (*before, Abstraction(last.points, 1.0, neighbours, last.widths))}


def _turned(representation: str, **loss: Any) -> dict[str, Any]:
    return {
        "options": {"representation": representation}, "representation": representation, **loss,
    }  # fmt: skip


SHORT = 0.6  # of the steps, for trainings on a quarter of the clouds
QUARTER = Views(share=0.25)
RUNS: dict[str, Run] = {
    **{f"{method}, book": Run(method, book=True) for method in training.METHODS[:4]},
    "cloudpose longer, book": Run("cloudpose", book=True, steps=LONGER),
    **{method: Run(method) for method in training.METHODS},
    **{
        f"{method}, {source}": Run(method, source=source)
        for source in ("estimated", "cut")
        for method in ("p2r", "p2p", "cloudpose")
    },
    "p2p, seen": Run("p2p", source="seen"),
    "p2p, crossed": Run("p2p", source="crossed"),
    **{
        f"{method}, {name}": Run(method, views=Views(glasses=(number,)), steps=SHORT)
        for method in training.METHODS[:4]
        for number, name in enumerate(GLASSES, 1)
    },
    **{
        f"{method}, quarter": Run(method, views=QUARTER, steps=SHORT)
        for method in training.METHODS[:4]
    },
    **{
        f"p2p, without {name}": Run(
            "p2p", views=Views(glasses=tuple({1, 2, 3, 4} - {number})), steps=SHORT
        )
        for number, name in enumerate(GLASSES, 1)
    },
    "p2p, three quarters": Run("p2p", views=Views(share=0.75), steps=SHORT),
    "p2r, plain quaternion": Run("p2r", {"sign_free": False}),
    "p2r, 6d": Run("p2r", _turned("6d")),
    "p2r, procrustes": Run("p2r", _turned("procrustes")),
    "p2r, euler": Run("p2r", _turned("euler")),
    "p2p, equal weights": Run("p2p", {"weights": (1 / 3, 1 / 3, 1 / 3)}),
    "p2p, no votes": Run("p2p", {"weights": (0.5, 0.5, 0.0)}),
    "p2p, 16 of all": Run("p2p", _layers(16)),
    "p2p, all": Run("p2p", _layers(32)),
    "p2p, early maximum": Run("p2p", {"options": {"early_max": True}}),
    "p2p, places": Run("p2p", {"options": {"places": True}}),
    "p2r, places": Run("p2r", {"options": {"places": True}}),
    "bins, frontal": Run("bins", views=QUARTER, steps=SHORT),
    "bins, even": Run("bins", views=Views(share=0.25, even=True), steps=SHORT),
    **{
        f"{method}, size {size:g}": Run(method, size=size, steps=SHORT)
        for method in ("p2p", "cloudpose")
        for size in (0.7, 1.0, 1.4)
    },
}
"""By name. What follows the comma tells a run from the method's own."""


def key(run: str, metric: str, glasses: str = "") -> Key:
    """What a run is measured by; all glasses if none are named."""
    return Key(run, "test", metric, glasses)


def recipe_of(run: Run) -> Any:
    """The recipe of a run at the scale in force."""
    make = training.compared if not run.book else training.at_book_size
    recipe = make(run.method, **run.changes)
    steps = max(choose(tiny=2, book=1, paper=1), round(run.steps * recipe.steps))
    return recipe if steps == recipe.steps else training.with_steps(recipe, steps)


def source_of(run: Run, seed: int) -> Source:
    """Where its clouds come from."""
    if run.source in ("seen", "crossed"):
        return sources.crossed(run.source == "seen", seed)
    return {
        "visible": training.visible, "estimated": sources.estimated, "cut": sources.cut,
    }[run.source]  # fmt: skip


def train_run(name: str, seed: int = 0, *, keep: bool = False) -> Trained:
    """Train one of `RUNS`.

    Args:
        name: of the run.
        seed: of weights, drivers, points and batches.
        keep: whether a training that was stopped goes on, and a finished one is found again.
    """
    run = RUNS[name]
    folder = None
    if keep:
        folder = resume_folder(train_run, name, seed, data=("headset/crowd",))
    return training.train(
        run.method, recipe_of(run), seed, views=run.views, source=source_of(run, seed),
        split=f"{training.CROWD} x {run.size:g}" if run.size else training.CROWD, folder=folder,
    )  # fmt: skip


def test_run(name: str, trained: Trained, seed: int) -> Tested:
    """What it errs on the test split, on clouds of the kind that it has learned from."""
    run = RUNS[name]
    split = f"{TEST} x {run.size:g}" if run.size else TEST
    return training.measure(trained, source_of(run, seed), seed, split)


def measured(name: str, found: Tested) -> dict[Key, float]:
    """The numbers of a run by key: over all glasses with each axis, and of each glasses."""
    values = _numbers(name, found.errors, "")
    for number, glasses in enumerate(GLASSES, 1):
        worn = (found.object_id == number).numpy()
        if worn.any():
            values |= _numbers(name, found.errors.only(worn), glasses)
    far = extreme(found.errors)
    if far.any():
        part = found.errors.only(far)
        values[key(name, "rotation, extreme")] = float(np.rad2deg(part.rotation).mean())
    return values


def extreme(errors: PoseErrors) -> np.ndarray:
    """(V,) bool, whether the true yaw is beyond `EXTREME`."""
    return np.abs(np.rad2deg(errors.true[:, 0])) > EXTREME


def _numbers(name: str, errors: PoseErrors, glasses: str) -> dict[Key, float]:
    values = {key(name, "rotation", glasses): float(np.rad2deg(errors.rotation).mean())}
    for metric, row in errors.orientation().items():
        for angle, number in row.items():
            words = metric if angle == "average" else f"{metric} {angle}"
            values[key(name, words, glasses)] = float(number)
    position = errors.position()
    values[key(name, "position", glasses)] = position["L2"]
    for axis in AXES:
        values[key(name, f"position {axis}", glasses)] = position[axis]
    return values
