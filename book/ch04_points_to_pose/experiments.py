"""What chapter 4 measures: five methods that say poses, what clouds cost, and what each part gives.

Angles are in degrees, positions in mm. "rotation" is the mean angle between rotations; "MAE",
"RMSE" and "BMAE" are means over yaw, pitch and roll, "MAE yaw" that of one of them; "position" is
the mean distance, "position x" the mean absolute error along an axis of the car.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from book.ch04_points_to_pose import cloud_sources as sources
from book.ch04_points_to_pose import costs, estimated_race, longer, runs
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose.claimed import CLAIMS
from book.ch04_points_to_pose.runs import key
from book.tools.checkpoints import Training
from book.tools.keys import Key
from book.tools.ledger import Measurement
from data_tools.shapes import GLASSES

__all__ = ["CHECKPOINTS", "CLAIMS", "MEASUREMENTS", "key"]

CONSTANT, ESTIMATOR = "constant", "cloud estimator"


def _measure(names: Iterable[str], seed: int) -> dict[Key, float]:
    values: dict[Key, float] = {}
    for name in names:
        trained = runs.train_run(name, seed, keep=True)
        values |= runs.measured(name, runs.test_run(name, trained, seed))
    return values


def measure_race(seed: int) -> dict[Key, float]:
    """All methods at the book's sizes, on true points or pictures, and the mean pose."""
    names = [name for name in runs.RUNS if name.endswith(", book")]
    values = _measure(names, seed) | runs.measured(CONSTANT, training.constant(seed=seed))
    bins, half = key("bins, book", "MAE"), key("cloudpose, book", "MAE")
    values[key("4 % of bins, book", "MAE")] = 0.04 * values[bins]
    values[key("half of cloudpose, book", "MAE")] = 0.5 * values[half]
    values[key("bins, book", "MAE, worse of the others")] = max(
        values[key("bins, book", f"MAE {angle}")] for angle in ("pitch", "roll")
    )
    for name in ("p2r, book", "p2p, book"):
        values[key(name, "BMAE, worst glasses")] = max(
            values[key(name, "BMAE", glasses)] for glasses in GLASSES
        )
    return values


def measure_clouds(seed: int) -> dict[Key, float]:
    """On true points, on chapter 3's clouds, on pictures; and the places that chapter 3 says."""
    methods = ("p2r", "p2p", "cloudpose")
    names = (*methods, *(f"{method}, estimated" for method in methods), "bins", "regression")
    places = runs.measured(ESTIMATOR, sources.estimated_places(training.TEST))
    own = {k: value for k, value in places.items() if k.metric.startswith("position")}
    return _measure(names, seed) | own


def measure_crossed(seed: int) -> dict[Key, float]:
    """On clouds of drivers that the cloud estimator has seen, and of others."""
    return _measure(("p2p, seen", "p2p, crossed"), seed)


def measure_glasses(seed: int) -> dict[Key, float]:
    """Trained on one glasses and tested on these; on as many clouds of all four."""
    values: dict[Key, float] = {}
    for method in training.METHODS[:4]:
        whole = _measure((f"{method}, quarter",), seed)
        # BMAE is no mean over views: both sides are the mean over glasses.
        by_glasses = {k: value for k, value in whole.items() if k.group}
        each = _each(f"{method}, {{}}", seed)
        values |= whole | _mean(f"{method}, quarter, mean over glasses", by_glasses)
        values |= each | _mean(f"{method}, single", each)
    return values


def measure_unseen(seed: int) -> dict[Key, float]:
    """Trained without one glasses and tested on these; on as many clouds of all four."""
    each = _each("p2p, without {}", seed)
    return each | _mean("p2p, unseen", each) | _measure(("p2p, three quarters",), seed)


def _each(name: str, seed: int) -> dict[Key, float]:
    """Of a run for each glasses, what is measured of these."""
    values: dict[Key, float] = {}
    for glasses in GLASSES:
        found = _measure((name.format(glasses),), seed)
        values |= {k: value for k, value in found.items() if k.group == glasses}
    return values


def _mean(name: str, each: dict[Key, float]) -> dict[Key, float]:
    """The mean over glasses, under a name."""
    metrics = {k.metric for k in each}
    return {
        key(name, metric): float(np.mean([v for k, v in each.items() if k.metric == metric]))
        for metric in sorted(metrics)
    }


def measure_sizes(seed: int) -> dict[Key, float]:
    """The same drivers with glasses of three sizes."""
    return _measure([name for name in runs.RUNS if ", size" in name], seed)


def measure_cut(seed: int) -> dict[Key, float]:
    """On clouds of which a side is missing."""
    return _measure(("p2r, cut", "p2p, cut", "cloudpose, cut"), seed)


def measure_votes(seed: int) -> dict[Key, float]:
    """With other weights of the losses."""
    return _measure(("p2p", "p2p, equal weights", "p2p, no votes"), seed)


def measure_balls(seed: int) -> dict[Key, float]:
    """With other last abstractions, and with the maximum taken early."""
    return _measure(("p2p", "p2p, 16 of all", "p2p, all", "p2p, early maximum"), seed)


def measure_heads(seed: int) -> dict[Key, float]:
    """With other numbers that stand for the rotation, and with the plain loss."""
    others = ("plain quaternion", "6d", "procrustes", "euler")
    return _measure(("p2r", *(f"p2r, {name}" for name in others)), seed)


def measure_places(seed: int) -> dict[Key, float]:
    """With and without the seeds' coordinates."""
    return _measure(("p2r", "p2r, places", "p2p", "p2p, places"), seed)


def measure_frontal(seed: int) -> dict[Key, float]:
    """RandomizedBins on a quarter of the instants: as they come, or with even yaws."""
    return _measure(("bins, frontal", "bins, even"), seed)


BOTH = ("headset/crowd", "headset/test")
MEASUREMENTS = {
    "race": Measurement(measure_race, range(3), BOTH),
    "clouds": Measurement(measure_clouds, range(3), BOTH),
    "estimated": Measurement(estimated_race.measure, range(3), BOTH),
    "unseen": Measurement(measure_unseen, range(3), BOTH),
    "heads": Measurement(measure_heads, range(3), BOTH),
    "votes": Measurement(measure_votes, range(3), BOTH),
    "glasses": Measurement(measure_glasses, range(3), BOTH),
    "regression": Measurement(longer.measure_regression, range(3), BOTH),
    "cut": Measurement(measure_cut, range(3), BOTH),
    "longer_p2p": Measurement(longer.measure_p2p, range(3), BOTH),
    "frontal": Measurement(measure_frontal, range(3), BOTH),
    "balls": Measurement(measure_balls, range(3), BOTH),
    "costs": Measurement(costs.measure, range(3), (), timed=True),
}


def _shipped(name: str) -> dict[str, Tensor]:
    """The first seed's network of the ledger, in half precision but for its norms' statistics."""
    net = runs.train_run(name, keep=True).net
    return {
        k: value if "running" in k or not torch.is_floating_point(value) else value.half()
        for k, value in net.state_dict().items()
    }


def train_p2p() -> dict[str, Tensor]:
    """P2P on true points, at the book's sizes."""
    return _shipped("p2p, book")


def train_p2r() -> dict[str, Tensor]:
    """P2R on true points, at the book's sizes."""
    return _shipped("p2r, book")


def train_p2p_estimated() -> dict[str, Tensor]:
    """P2P on chapter 3's clouds, of the smaller sizes."""
    return _shipped("p2p, estimated")


CHECKPOINTS = {
    "p2p": Training(train_p2p, ("headset/crowd",)),
    "p2r": Training(train_p2r, ("headset/crowd",)),
    "p2p_estimated": Training(train_p2p_estimated, ("headset/crowd",)),
}
