"""How chapter 4 trains what says poses, and measures what it has learned.

All methods learn from the same views of `headset`'s crowd of drivers: networks on clouds from what
is truly visible or from chapter 3's clouds, networks on pictures from the infrared images.
Networks that are compared are smaller than those that the page ships.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

import data_tools
from data_tools import batches
from data_tools.worlds.redrawn import Redrawn
from posecore.arrays import fail, require_number
from posecore.methods.cloudpose.recipe import RECIPES as CLOUDPOSE
from posecore.methods.infrared.triples import first_rows
from posecore.methods.points_to_pose.centred_clouds import predict_poses
from posecore.methods.points_to_pose.constant import ConstantPose
from posecore.methods.points_to_pose.evaluation import PoseErrors, pose_errors
from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.pose_clouds import PoseClouds, visible_clouds
from posecore.methods.points_to_pose.recipe import RECIPES as POINTS
from posecore.methods.random_bins.recipe import RECIPES as PICTURES
from posecore.nets.pointnet2 import Abstraction
from posecore.rotations import matrix_to_euler
from posecore.scale import choose, scale
from posecore.training import History, fit

__all__ = [
    "CROWD",
    "METHODS",
    "SMALL_LAYERS",
    "TEST",
    "Source",
    "Tested",
    "Trained",
    "TruePoses",
    "Views",
    "at_book_size",
    "chosen_views",
    "compared",
    "constant",
    "in_car",
    "measure",
    "recipe",
    "stack",
    "tested",
    "train",
    "true_poses",
    "visible",
    "with_steps",
]

CROWD, TEST = "crowd", "test"
Source = Callable[[str, int, int], PoseClouds]
"""`source(split, count, seed)`: clouds of `count` points of all views of a split."""
METHODS = ("p2r", "p2p", "cloudpose", "bins", "regression")
"""What is trained; the last two see pictures."""
ON_PICTURES = METHODS[3:]
SMALL_LAYERS = (
    Abstraction(64, 0.05, 16, (16, 16, 32)), Abstraction(32, 0.1, 16, (32, 32, 64)),
    Abstraction(16, 0.2, 16, (32, 32, 64)),
)  # fmt: skip
"""Half as wide as the book's."""
AT_ONCE = 256  # pictures


def recipe(method: str) -> Any:
    """That of the scale in force."""
    known = {"cloudpose": CLOUDPOSE, "bins": PICTURES, "regression": PICTURES}
    found = known.get(method, POINTS)[scale()]
    return found if method == "cloudpose" else replace(found, kind=method)


def compared(method: str, **changes: Any) -> Any:
    """The smaller recipe of the networks that are compared; `changes` is what tells them apart.

    Args:
        method: one of `METHODS`.
        changes: fields of the method's recipe; for P2R and P2P what `PoseLoss` takes may be among
            them.
    """
    sizes: dict[str, Any] = {
        "steps": choose(tiny=4, book=1200, paper=1200), "batch": choose(tiny=4, book=16, paper=16),
    }  # fmt: skip
    if method in ("p2r", "p2p"):
        own = {
            name: changes.pop(name) for name in list(changes) if name in PoseLoss.__annotations__
        }
        sizes["loss"] = partial(recipe(method).loss, **own)
        if scale() != "tiny":
            sizes |= {
                "layers": SMALL_LAYERS, "propagations": ((64, 64),), "widths": (64, 64),
                "hidden": (64, 64), "dense": 128,
            }  # fmt: skip
    if method in ON_PICTURES and scale() != "tiny":
        sizes |= {"image": (80, 47)}
    return replace(recipe(method), **sizes | changes)


def at_book_size(method: str, **changes: Any) -> Any:
    """The recipe that the page ships, with as many steps and samples in each for all methods."""
    sizes: dict[str, Any] = {
        "steps": choose(tiny=4, book=2000, paper=2000), "batch": choose(tiny=4, book=32, paper=32),
    }  # fmt: skip
    if method in ON_PICTURES and scale() != "tiny":
        sizes |= {"image": (80, 47)}
    return replace(recipe(method), **sizes | changes)


def with_steps(recipe: Any, steps: int) -> Any:
    """The same recipe with another number of steps."""
    return replace(recipe, steps=steps)


@lru_cache(maxsize=4)
def stack(split: str) -> batches.Stack:
    """A split of `headset` at the scale in force.

    Args:
        split: its name; "crowd x 0.7" are the first of its instants with glasses of another size.
    """
    name, _, factor = split.partition(" x ")
    if not factor:
        return batches.load(data_tools.open("headset", split=name), progress=False)
    few = (
        choose(tiny=8, book=400, paper=400)
        if name == CROWD
        else choose(tiny=4, book=100, paper=100)
    )
    views = Redrawn(range(few), split=name, scale=scale(), glasses_scale=float(factor))
    return batches.load(views, progress=False)


@lru_cache(maxsize=4)
def visible(split: str, count: int, seed: int = 0) -> PoseClouds:
    """What each camera truly sees of head and glasses: `count` points, drawn by the seed."""
    return visible_clouds(stack(split), count, seed)


@lru_cache(maxsize=4)
def _pictures(split: str, image: tuple[int, int]) -> Any:
    return replace(recipe("bins"), image=image).pictures(stack(split))


@dataclass(frozen=True)
class Views:
    """Which views of the crowd a network learns from.

    Attributes:
        glasses: object ids, 1 to 4; empty for all.
        share: of these views, drawn by instants.
        even: whether yaws are about equally often rather than as drivers look.
        drivers: of the crowd's, what share; drawn anew by each seed.
    """

    glasses: tuple[int, ...] = ()
    share: float = 1.0
    even: bool = False
    drivers: float = 0.8

    def __post_init__(self) -> None:
        require_number("share", self.share, above=0, high=1)
        require_number("drivers", self.drivers, above=0, high=1)
        if not set(self.glasses) <= {1, 2, 3, 4}:
            fail("glasses", "numbers from 1 to 4", self.glasses)


def chosen_views(which: Views, seed: int, split: str = CROWD) -> Tensor:
    """(V,) int64, views of the crowd; a seed has other drivers, and other instants of a share."""
    data, truth = stack(split), true_poses(split)
    generator = torch.Generator().manual_seed(seed)
    first = data.groups[:, 0]  # of each instant
    subjects = data.scene_id.unique()
    count = max(2, round(which.drivers * len(subjects)))
    drivers = subjects[torch.randperm(len(subjects), generator=generator)[:count]]
    keep = torch.isin(data.scene_id[first], drivers)
    if which.glasses:
        keep &= torch.isin(truth.object_id[first], torch.tensor(which.glasses))
    instants = keep.nonzero()[:, 0]
    if which.share < 1:
        weights = torch.ones(len(instants))
        if which.even:
            bins = (truth.angles[first[instants], 0].abs().rad2deg() / 5).long()
            weights /= torch.bincount(bins)[bins]
        few = max(2, round(which.share * len(instants)))
        instants = instants[torch.multinomial(weights, few, generator=generator)]
    return data.groups[instants].flatten()


class TruePoses(NamedTuple):
    """Poses of the glasses in the car, of the V views of a split."""

    R: Tensor  # (V, 3, 3) float64
    t: Tensor  # (V, 3) metres
    angles: Tensor  # (V, 3) radians: yaw, pitch, roll
    object_id: Tensor  # (V,) int64, which glasses


@lru_cache(maxsize=4)
def true_poses(split: str) -> TruePoses:
    """Those of a split."""
    data = stack(split)
    rows, T = first_rows(data), data.T_world_cam
    R, t = in_car(data.R[rows].double(), data.t[rows].double(), T)
    return TruePoses(R, t, matrix_to_euler(R), data.object_id[rows])


def in_car(R: Tensor, t: Tensor, T_world_cam: Tensor) -> tuple[Tensor, Tensor]:
    """Poses (V, 3, 3), (V, 3) in the frames of cameras (V, 4, 4), in the car's."""
    turn, place = T_world_cam[:, :3, :3].double(), T_world_cam[:, :3, 3].double()
    R, t = R.double(), t.double()
    return turn @ R, (turn @ t[..., None])[..., 0] + place


class Trained(NamedTuple):
    """A network, by which recipe it was trained, how that went, and how long it took."""

    method: str
    recipe: Any
    net: nn.Module
    history: History
    seconds: float  # of one processor's time


def train(
    method: str,
    recipe: Any,
    seed: int = 0,
    *,
    views: Views = Views(),
    source: Source = visible,
    split: str = CROWD,
    folder: Path | None = None,
    show: bool | None = False,
) -> Trained:
    """Train a network.

    Args:
        method: one of `METHODS`.
        recipe: of the method.
        seed: of weights, drivers, points and batches.
        views: which views of the crowd.
        source: `source(split, count, seed)` gives clouds, for methods on clouds.
        split: of `headset`, as for `stack`.
        folder: where a training that was stopped goes on.
        show: as for `fit`.
    """
    chosen = chosen_views(views, seed, split)
    if method in ON_PICTURES:
        data = _pictures(split, recipe.image).only(chosen)
        net = recipe.new_net(data, seed)
    else:
        clouds = source(split, recipe.points, seed)
        data = recipe.prepared(clouds.only(torch.isin(clouds.view, chosen)))
        net = recipe.new_net(seed)
    start = time.process_time()
    history = fit(
        net, recipe.batches(data, seed=seed), recipe.new_loss(), steps=recipe.steps, seed=seed,
        device="cpu", resume=folder, show=show, **recipe.fit,
    )  # fmt: skip
    return Trained(method, recipe, net, history, time.process_time() - start)


def measure(trained: Trained, source: Source = visible, seed: int = 0, split: str = TEST) -> Tested:
    """Errors in the views of the test split, or of another."""
    if trained.method in ON_PICTURES:
        pictures = _pictures(split, trained.recipe.image)
        R, t = in_car(*_of_pictures(trained.net, pictures), stack(split).T_world_cam)
        return tested(R, t, pictures.view, split)
    clouds = source(split, trained.recipe.points, seed)
    R, t = predict_poses(trained.net, trained.recipe.prepared(clouds))
    return tested(R, t, clouds.view, split)


class Tested(NamedTuple):
    """What was found in V views."""

    errors: PoseErrors
    object_id: Tensor  # (V,) int64, which glasses
    view: Tensor  # (V,) int64, of the split


def tested(R: Tensor, t: Tensor, view: Tensor, split: str = TEST) -> Tested:
    """Errors of poses (V, 3, 3), (V, 3) in the car, of views (V,) of a split."""
    truth = true_poses(split)
    errors = pose_errors(R.double(), t.double(), truth.R[view], truth.t[view])
    return Tested(errors, truth.object_id[view], view)


@torch.no_grad()
def _of_pictures(net: nn.Module, pictures: Any) -> tuple[Tensor, Tensor]:
    said = [net(part.float() / 255) for part in pictures.images.split(AT_ONCE)]
    return torch.cat([part.R for part in said]), torch.cat([part.t for part in said])


def constant(views: Views = Views(), seed: int = 0) -> Tested:
    """What the mean pose of the training views, said of every view, errs."""
    truth, chosen = true_poses(CROWD), chosen_views(views, seed)
    said = ConstantPose.fit(truth.R[chosen], truth.t[chosen])
    count = len(stack(TEST))
    return tested(*said(count), torch.arange(count))
