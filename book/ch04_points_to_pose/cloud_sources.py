"""Clouds that chapter 4 learns from besides those that are truly visible.

Those that chapter 3's networks make of infrared images, and those that are cut as at the border of
an image.
"""

from __future__ import annotations

from functools import lru_cache, partial

import torch
from torch import Tensor

from book.ch03_infrared_to_clouds import cloud_training as chapter3
from book.ch03_infrared_to_clouds import experiments as experiments3
from book.ch03_infrared_to_clouds import looking as looking3
from book.ch04_points_to_pose.pose_training import (
    CROWD,
    Source,
    Tested,
    stack,
    tested,
    true_poses,
    visible,
)
from book.tools.checkpoints import load_or_train
from posecore.methods.infrared.clouds import predict
from posecore.methods.infrared.network import CloudNet
from posecore.methods.infrared.recipe import Recipe
from posecore.methods.points_to_pose.pose_clouds import PoseClouds
from posecore.training import fit

__all__ = ["KEPT", "crossed", "cut", "estimated", "estimated_places"]

KEPT = (0.5, 1.0)
"""What share of a cloud's points is left of it at least and at most where it is cut."""


@lru_cache(maxsize=2)
def cut(split: str, count: int, seed: int = 0) -> PoseClouds:
    """Visible clouds of which one side is missing, as of a head at the border of an image.

    Of each a part of the points is left, from a half to all, on one side of a plane along the
    car's z whose direction is drawn; `count` of them.
    """
    clouds = visible(split, 2 * count, seed)
    generator = torch.Generator().manual_seed(seed + 1)
    views, total = clouds.points.shape[:2]
    angle = 2 * torch.pi * torch.rand(views, generator=generator)
    low, high = KEPT
    share = low + (high - low) * torch.rand(views, generator=generator)
    along = torch.stack([angle.cos(), angle.sin()], -1)[:, :, None]
    place = (clouds.points[..., :2] @ along)[..., 0]  # (V, 2N)
    gone = place.argsort(1).argsort(1) >= (share * total).round()[:, None]
    order = (torch.rand(views, total, generator=generator) + gone).argsort(1)[:, :count]
    points = clouds.points.gather(1, order[..., None].expand(-1, -1, 3))
    parts = (clouds.R, clouds.t, clouds.object_id, clouds.scene_id, clouds.view)
    return PoseClouds(points, clouds.worn.gather(1, order), *parts)


@lru_cache(maxsize=1)
def shipped() -> tuple[CloudNet, Recipe]:
    """The cloud estimator that chapter 3 ships, and its recipe."""
    recipe = chapter3.recipe()
    return load_or_train(experiments3, "clouds", looking3.blank_net(recipe)), recipe


@lru_cache(maxsize=4)
def estimated(split: str, count: int, seed: int = 0) -> PoseClouds:
    """What the cloud estimator that chapter 3 ships makes of infrared images; its order by seed.

    It was trained on all of the crowd, so clouds of the crowd are of images that it has seen.
    """
    net, recipe = shipped()
    points, _ = made_by(net, recipe, split)
    return posed(split, points).thinned(count, seed)


def estimated_places(split: str) -> Tested:
    """The errors of its translation alone, beside a rotation that is always the identity."""
    net, recipe = shipped()
    _, t = made_by(net, recipe, split)
    return tested(torch.eye(3).expand(len(t), 3, 3), t, torch.arange(len(t)), split)


@lru_cache(maxsize=4)
def made_by(net: CloudNet, recipe: Recipe, split: str) -> tuple[Tensor, Tensor]:
    """(V, N, 3) clouds and (V, 3) translations in the car, metres, of the views of a split."""
    triples = chapter3.triples_for(recipe, split)
    order = triples.views.flatten().argsort()
    cloud = predict(net, triples.images.flatten(0, 1)[order])
    T = stack(split).T_world_cam.float()
    turn, place = T[:, :3, :3], T[:, None, :3, 3]
    t = cloud.t[:, None]
    return (cloud.points + t) @ turn.mT + place, (t @ turn.mT + place)[:, 0]


def posed(split: str, points: Tensor) -> PoseClouds:
    """Clouds (V, N, 3) in the car of all views of a split, with the true poses."""
    truth = true_poses(split)
    return PoseClouds(
        points, None, truth.R.float(), truth.t.float(), truth.object_id, stack(split).scene_id,
        torch.arange(len(points)),
    )  # fmt: skip


@lru_cache(maxsize=1)
def halves(seed: int) -> tuple[tuple[CloudNet, CloudNet], Tensor, Recipe]:
    """Two small cloud estimators, each trained on half of the crowd's drivers.

    Returns:
        The networks, (V,) int64 which of them has seen a view, and their recipe.
    """
    data, recipe = stack(CROWD), chapter3.compared()
    drivers = data.scene_id.unique()
    # Another draw than that of the drivers that poses are learned from.
    generator = torch.Generator().manual_seed(seed + 1000)
    second = drivers[torch.randperm(len(drivers), generator=generator)[: len(drivers) // 2]]
    seen_by = torch.isin(data.scene_id, second).long()
    triples = chapter3.triples_for(recipe, CROWD)
    nets = []
    for half in range(2):
        part = triples.only((seen_by[triples.views[:, 0]] == half).nonzero()[:, 0])
        net = recipe.new_net(part, seed)
        fit(
            net, recipe.batches(part, seed=seed), recipe.new_loss(part.size), steps=recipe.steps,
            seed=seed, device="cpu", show=False, **recipe.fit,
        )  # fmt: skip
        nets.append(net)
    return tuple(nets), seen_by, recipe


def crossed(own: bool, networks: int) -> Source:
    """Clouds of two networks, each trained on half of the drivers.

    Args:
        own: whether a driver's clouds are by the network that has seen the driver, else by the
            other. Views of other splits are in turns by the one and the other.
        networks: the seed of the two.
    """
    return partial(_crossed, own, networks)


@lru_cache(maxsize=4)
def _crossed(own: bool, networks: int, split: str, count: int, seed: int) -> PoseClouds:
    nets, seen_by, recipe = halves(networks)
    both = torch.stack([made_by(net, recipe, split)[0] for net in nets])
    if split == CROWD:
        which = seen_by if own else 1 - seen_by
    else:
        which = torch.arange(both.shape[1]) % 2
    return posed(split, both[which, torch.arange(both.shape[1])]).thinned(count, seed)
