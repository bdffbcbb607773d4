"""What chapter 4's page looks at: networks that were trained, their votes, and what moves them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import data_tools
from book.ch03_infrared_to_clouds.drawing.views import bright
from book.ch04_points_to_pose import cloud_sources as sources
from book.ch04_points_to_pose import experiments, runs
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose.pose_training import Tested, Trained
from book.tools.checkpoints import load_or_train
from data_tools import batches
from data_tools.worlds.redrawn import Redrawn
from posecore.figures.results import Estimate, best_median_worst
from posecore.methods.infrared.clouds import predict
from posecore.methods.infrared.triples import reduced
from posecore.methods.points_to_pose.centred_clouds import predict_poses
from posecore.methods.points_to_pose.pose_clouds import visible_clouds
from posecore.methods.points_to_pose.voting import fused_keypoints, keypoint_pose
from posecore.metrics import rotation_error
from posecore.poses import apply, from_matrix, relative
from posecore.scale import choose, scale
from posecore.training import History, fit

__all__ = [
    "Answer",
    "Moved",
    "answer",
    "by_formula",
    "estimated_cloud",
    "examples",
    "loaded",
    "moved_by",
    "watch",
]

KEYS = {"p2p": "p2p, book", "p2r": "p2r, book", "p2p_estimated": "p2p, estimated"}
"""Which run of the ledger each network is that the page loads."""


def loaded(key: str) -> Trained:
    """A network that the page ships, with its recipe.

    Args:
        key: of `experiments.CHECKPOINTS`.
    """
    run = runs.RUNS[KEYS[key]]
    recipe = runs.recipe_of(run)
    net = load_or_train(experiments, key, recipe.new_net())
    return Trained(run.method, recipe, net, None, 0.0)


def watch(steps: int, drivers: int) -> History:
    """Train a small P2P on a few drivers of the crowd, with a live curve.

    Args:
        steps: of training.
        drivers: how many, of four instants each.
    """
    recipe = training.compared("p2p", steps=steps)
    views = Redrawn(range(4 * drivers), split=training.CROWD, scale=scale())
    data = batches.load(views, progress=False)
    clouds = recipe.prepared(visible_clouds(data, recipe.points))
    return fit(
        recipe.new_net(), recipe.batches(clouds), recipe.new_loss(), steps=steps, device="cpu",
        show=True, **recipe.fit,
    )  # fmt: skip


class Answer(NamedTuple):
    """What a network says of one cloud, all in the car."""

    cloud: Tensor  # (N, 3) metres
    seeds: Tensor  # (S, 3)
    votes: Tensor | None  # (S, K, 3)
    keypoints: Tensor | None  # (K, 3)
    R: Tensor  # (3, 3)
    t: Tensor  # (3,)


@torch.no_grad()
def answer(trained: Trained, points: Tensor) -> Answer:
    """Everything that P2P says of a cloud.

    Args:
        trained: the network.
        points: (N, 3) metres in the car.
    """
    centre = points.mean(0)
    geometry = trained.net.geometry((points - centre)[None])
    said = trained.net(geometry)
    seeds = trained.net.backbone(geometry).points[0]
    return Answer(
        points, seeds + centre, said.votes[0] + centre, said.keypoints[0] + centre,
        trained.net.decode(said)[0], said.t[0] + centre,
    )  # fmt: skip


@torch.no_grad()
def by_formula(trained: Trained) -> tuple[Tested, Tested]:
    """Errors in the test split: of the poses that P2P's heads say, and of Kabsch's on its votes."""
    clouds = training.visible(training.TEST, trained.recipe.points)
    ready = trained.recipe.prepared(clouds)
    model = fused_keypoints(trained.recipe.keypoints - 1)
    found = [
        keypoint_pose(trained.net(ready.geometry.select(rows)).keypoints, model)
        for rows in torch.arange(len(ready)).split(256)
    ]
    R, t = (torch.cat([part[k] for part in found]) for k in range(2))
    return training.measure(trained), training.tested(R, t + ready.centre, clouds.view)


def examples(trained: Trained) -> dict[str, Estimate]:
    """The best, the median and the worst answer in the test split, by the angle, on pictures."""
    dataset, data = data_tools.open("headset", split=training.TEST), training.stack(training.TEST)
    clouds = training.visible(training.TEST, trained.recipe.points)
    R, t = predict_poses(trained.net, trained.recipe.prepared(clouds))
    found = training.tested(R, t, clouds.view)
    degrees = np.rad2deg(found.errors.rotation)
    shown = {}
    for name, row in best_median_worst(degrees).items():
        view = int(clouds.view[row])
        item = dataset[view].objects[0]
        camera = from_matrix(data.T_world_cam[view].numpy())
        said = relative(*camera, R[row].double().numpy(), t[row].double().numpy())
        grey = bright(data.image("ir", view))[..., None].repeat(3, -1)
        shown[f"{name}, {degrees[row]:.1f}°"] = Estimate(
            grey, data.K[view].numpy(), item.size, (item.R, item.t), said
        )
    return shown


def estimated_cloud(view: int) -> Tensor:
    """(N, 3) metres in the car, what chapter 3's network makes of a view of the test split."""
    net, recipe = sources.shipped()
    item = data_tools.open("headset", split=training.TEST, whole=False)[view]
    picture = reduced(item.ir.astype(np.float32), recipe.image)[None, None]
    cloud = predict(net, picture)
    points = cloud.points[0] + cloud.t[0]
    chosen = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))[:256]
    camera = from_matrix(torch.from_numpy(item.T_world_cam).float())
    return apply(*camera, points[chosen])


class Moved(NamedTuple):
    """What becomes of a network's answers when a part of the clouds is taken away."""

    turned: np.ndarray  # (V,) degrees between the answer and that of the whole cloud
    error: np.ndarray  # (V,) degrees between the answer and the truth
    off: np.ndarray  # (V,) mm between the translation and the true one


@torch.no_grad()
def moved_by(trained: Trained, count: int) -> dict[str, Moved]:
    """What the network says of whole clouds, without the glasses, and of the glasses alone.

    Clouds are drawn of many points first, so that each part has enough. All keep the centre of the
    whole cloud. Points are drawn anew each time, so there are two controls: the whole cloud drawn
    again, and without as many points of the head as the glasses have.

    Args:
        trained: the network.
        count: how many views of the test split, evenly spread.
    """
    clouds = training.visible(training.TEST, 2000)
    worn = clouds.worn.sum(1)
    fitting = (worn >= choose(tiny=8, book=64, paper=64)).nonzero()[:, 0]
    few = fitting[torch.linspace(0, len(fitting) - 1, min(count, len(fitting))).long()]
    points, worn = clouds.points[few], clouds.worn[few]
    centre = points.mean(1, keepdim=True)
    generator = torch.Generator().manual_seed(0)
    order = (torch.rand(worn.shape, generator=generator) + worn).argsort(1).argsort(1)
    parts = {
        "whole": torch.ones_like(worn),
        "drawn anew": torch.ones_like(worn),
        "without as much of the head": order >= worn.sum(1, keepdim=True),
        "without glasses": ~worn,
        "glasses alone": worn,
    }
    found: dict[str, Any] = {}
    for name, mask in parts.items():
        # Of what is left so many points are drawn, some twice where fewer are left.
        chosen = mask.float().multinomial(
            trained.recipe.points, replacement=True, generator=generator
        )
        part = (points - centre).gather(1, chosen[..., None].expand(-1, -1, 3))
        found[name] = trained.net.pose(trained.net.geometry(part))
    truth = training.true_poses(training.TEST)
    R, t = truth.R[clouds.view[few]], truth.t[clouds.view[few]]
    whole = found["whole"][0].double()
    return {
        name: Moved(
            np.rad2deg(rotation_error(said_R.double(), whole).numpy()),
            np.rad2deg(rotation_error(said_R.double(), R).numpy()),
            1000 * (said_t.double() + centre[:, 0] - t).norm(dim=1).numpy(),
        )
        for name, (said_R, said_t) in found.items()
    }
