"""How chapter 3 trains cloud estimators, and measures what they have learned.

The network that the page ships has the book's sizes and is trained on `headset`'s crowd of drivers.
Those that are compared are smaller: images of 80 x 47, a grid of 40 x 24 x 40 voxels.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from trimesh import Trimesh
from trimesh.sample import sample_surface

import data_tools
from book.tools.checkpoints import resume_folder
from data_tools import batches
from data_tools.batches.decoding import NONE
from data_tools.shapes import GLASSES, make_glasses, make_subject
from data_tools.worlds.headset import SUBJECTS
from posecore.cameras import depth_to_points
from posecore.methods.infrared.clouds import predict
from posecore.methods.infrared.evaluation import first_met, overlap, surface_distances
from posecore.methods.infrared.losses import CloudLoss
from posecore.methods.infrared.network import Cloud, CloudNet
from posecore.methods.infrared.recipe import RECIPES, Recipe
from posecore.methods.infrared.triples import Triples
from posecore.scale import choose, scale
from posecore.training import History, fit

__all__ = [
    "CROWD",
    "TEST",
    "Measured",
    "compared",
    "evaluate",
    "recipe",
    "stack",
    "train_net",
    "triples",
    "true_masks",
    "visible_surface",
]

CROWD, TEST = "crowd", "test"
SHARP = 0.4  # voxels, the blur with which silhouettes are compared: that of the end of training


def recipe() -> Recipe:
    """That of the scale in force."""
    return RECIPES[scale()]


def compared(**changes: object) -> Recipe:
    """The smaller recipe of the networks that are compared; `changes` is what tells them apart.

    Args:
        changes: fields of `Recipe`; what `CloudLoss` takes may be among them.
    """
    own = {name: changes.pop(name) for name in list(changes) if name in CloudLoss.__annotations__}
    loss = partial(CloudLoss, **{"blur": (2.0, SHARP), "keep": (0.2, 1.0)} | own)
    sizes = {
        "image": (80, 47), "grid": (40, 24, 40), "points": choose(tiny=128, book=512, paper=512),
        "blocks": 5, "steps": choose(tiny=4, book=1500, paper=1500),
        "batch": choose(tiny=4, book=16, paper=16), "loss": loss, "own_view": True,
    }  # fmt: skip
    return replace(recipe(), **sizes | changes)


@lru_cache(maxsize=4)
def stack(split: str) -> batches.Stack:
    """A split of `headset` at the scale in force."""
    return batches.load(data_tools.open("headset", split=split), progress=False)


@lru_cache(maxsize=4)
def triples(
    split: str, image: tuple[int, int], grid: tuple[int, int], masks: str = "exact"
) -> Triples:
    """A split as networks of some sizes see it."""
    return Triples(stack(split), image=image, grid=grid, masks=masks)


def triples_for(recipe: Recipe, split: str | batches.Stack) -> Triples:
    """A split, or other views, as the network of a recipe sees them."""
    if isinstance(split, str):
        return triples(split, recipe.image, recipe.grid[:2], recipe.masks)
    return recipe.triples(split)


def train_net(
    recipe: Recipe,
    *,
    split: str | batches.Stack = CROWD,
    seed: int = 0,
    name: str = "",
    show: bool | None = False,
    keep: bool = True,
) -> tuple[CloudNet, History]:
    """A network, trained by a recipe.

    Args:
        recipe: what is trained.
        split: of `headset`; or views of its instants, with which nothing is kept.
        seed: of weights, and of which instants come when.
        name: of the training, which tells it from others of its scale.
        show: as for `fit`.
        keep: whether a training that was stopped goes on, and a finished one is found again.
    """
    data = triples_for(recipe, split)
    net = recipe.new_net(data, seed)
    details = name, seed, recipe.steps
    folder = None
    if keep and isinstance(split, str):
        folder = resume_folder(train_net, *details, data=(f"headset/{split}",))
    history = fit(
        net, recipe.batches(data, seed=seed), recipe.new_loss(data.size), steps=recipe.steps,
        seed=seed, device="cpu", resume=folder, recipe={"name": name}, show=show, **recipe.fit,
    )  # fmt: skip
    return net, history


class Measured(NamedTuple):
    """What is measured of the clouds of a split, each view of G instants and J cameras by itself.

    Attributes:
        views: (G, J) their numbers in the split.
        overlaps: (G, J, J) of the silhouette in each view, from the cloud of each.
        at_truth: (G, J, J) the same, with the cloud put where it truly is.
        off: (G, J) metres from the predicted to the true translation.
        to_cloud: (G, J) metres from the visible surface to the cloud, on average; nan where none.
        to_surface: (G, J) metres from the points that are met first to that surface.
    """

    views: Tensor
    overlaps: Tensor
    at_truth: Tensor
    off: Tensor
    to_cloud: Tensor
    to_surface: Tensor

    def unseen(self, overlaps: Tensor | None = None) -> Tensor:
        """(G, J) mean overlap in the views that the network was not given."""
        overlaps = self.overlaps if overlaps is None else overlaps
        count = overlaps.shape[-1]
        own = torch.eye(count, dtype=torch.bool)
        return overlaps.masked_fill(own, 0).sum(-1) / (count - 1)


def evaluate(
    net: CloudNet,
    recipe: Recipe,
    split: str | batches.Stack = TEST,
    *,
    most: int | None = None,
    surfaces: bool = True,
) -> Measured:
    """Measure the clouds of a split.

    Args:
        net, recipe: the network, and what it was trained by.
        split: of `headset`, or views of its instants.
        most: no more instants than so many, evenly spread; None for all.
        surfaces: whether distances to the surface are measured.
    """
    data = triples_for(recipe, split)
    chosen = torch.arange(len(data))
    if most is not None and most < len(data):
        chosen = torch.linspace(0, len(data) - 1, most).round().long()
    part = data.only(chosen)
    count, cameras = part.views.shape
    cloud = predict(net, part.images.flatten(0, 1))
    cloud = Cloud(*(values.unflatten(0, (count, cameras)) for values in cloud))
    masks = true_masks(split, part.views)
    loss = recipe.new_loss(part.size)
    off = (cloud.t - part.t).norm(dim=-1)
    shape = count, cameras, cameras
    overlaps, at_truth = torch.zeros(shape), torch.zeros(shape)
    to_cloud, to_surface = torch.full(off.shape, torch.nan), torch.full(off.shape, torch.nan)
    for j in range(cameras):
        anchors = cloud.t[:, j], part.t[:, j]
        if not loss.relative:
            anchors = (net.middle.expand(count, 3),) * 2
        for result, anchor in zip((overlaps, at_truth), anchors, strict=True):
            seen = loss.projector(
                cloud.points[:, j], anchor, part.T_world_cam[:, j], part.K, part.T_world_cam,
                scale=cloud.scale[:, j] if loss.use_scale else 1.0, sigma=loss.blur[1],
            )  # fmt: skip
            result[:, j] = overlap(seen.silhouette, masks)
        if not surfaces:
            continue
        own = part.T_world_cam[:, j], part.K[:, j : j + 1], part.T_world_cam[:, j : j + 1]
        voxels = loss.projector.to_voxels(cloud.points[:, j], anchors[1], *own)[:, 0]
        met = first_met(voxels)
        for g, view in enumerate(part.views[:, j].tolist()):
            surface = visible_surface(split, view)
            if len(surface) and met[g].any():
                # Where the cloud truly is: how far off its place is, is measured by itself.
                placed = cloud.points[g, j] + anchors[1][g]
                to_cloud[g, j], to_surface[g, j] = surface_distances(placed, met[g], surface)
    return Measured(part.views, overlaps, at_truth, off, to_cloud, to_surface)


def true_masks(split: str | batches.Stack, views: Tensor) -> Tensor:
    """(..., H, W) bool, where head or glasses are seen in views of a split, or of others."""
    data = stack(split) if isinstance(split, str) else split
    flat = [data.image("instance", view) != NONE for view in views.flatten().tolist()]
    return torch.from_numpy(np.stack(flat)).unflatten(0, views.shape)


def visible_surface(split: str | batches.Stack, view: int) -> Tensor:
    """(M, 3) float32 metres, the surface of head and glasses that a camera sees, in its frame."""
    data = stack(split) if isinstance(split, str) else split
    depth = data.image("depth", view).astype(np.float32) * np.float32(data.depth_step)
    depth[data.image("instance", view) == NONE] = 0
    if not depth.any():
        return torch.zeros(0, 3)
    return torch.from_numpy(depth_to_points(depth, data.K[view].numpy())).float()


def floors(seed: int) -> dict[str, Tensor]:
    """Overlaps in all views of what knows no image: one head of the crowd, put at the true place.

    Args:
        seed: of whose head it is, and of its points.

    Returns:
        (G, J) for a head that looks straight ahead in the car, and for one at the true pose.
    """
    sizes = compared()
    data = triples_for(sizes, TEST)
    projector = sizes.projector(data.size)
    points = head_points(SUBJECTS[CROWD][seed], sizes.points, seed)
    own, t = data.T_world_cam[:, 0], data.t[:, 0]
    turns = {"head straight ahead": own[:, :3, :3].mT, "head at the true pose": data.R[:, 0]}
    masks = true_masks(TEST, data.views)
    return {
        name: overlap(
            projector(points @ R.mT, t, own, data.K, data.T_world_cam, sigma=SHARP).silhouette,
            masks,
        )
        for name, R in turns.items()
    }


@lru_cache(maxsize=4)
def head_points(subject: int, count: int, seed: int) -> Tensor:
    """(N, 3) float32 metres, points of a head with glasses, in the glasses' frame."""
    head, glasses = make_subject(subject).head, make_glasses(GLASSES[subject % len(GLASSES)])
    worn = count // 8
    points = [
        sample_surface(Trimesh(mesh.vertices, mesh.faces, process=False), some, seed=seed)[0]
        for mesh, some in ((head, count - worn), (glasses, worn))
    ]
    return torch.from_numpy(np.concatenate(points)).float()
