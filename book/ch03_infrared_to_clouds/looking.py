"""What chapter 3's page looks at: clouds of views, ceilings, a brief training, and its costs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from IPython.display import display
from torch import Tensor

import data_tools
from book.ch03_infrared_to_clouds import cloud_training as training
from data_tools import batches
from data_tools.views import View
from data_tools.worlds import headset
from data_tools.worlds.redrawn import Redrawn
from posecore.cameras import depth_to_points, project
from posecore.figures import Picture
from posecore.methods.infrared.clouds import predict
from posecore.methods.infrared.evaluation import first_met, overlap
from posecore.methods.infrared.network import SIZES, Cloud, CloudNet
from posecore.methods.infrared.recipe import RECIPES, Recipe
from posecore.methods.infrared.triples import reduced
from posecore.scale import choose, scale
from posecore.splat import Pictures
from posecore.training import History, fit

__all__ = [
    "blank_net",
    "case",
    "ceiling",
    "cloud_of",
    "constant_translation",
    "off_by_axis",
    "pictures_of",
    "seconds_of_a_step",
    "seen_and_guessed",
    "surface_of",
    "targets_of",
    "train_watched",
]


STAGES = 6  # of a training that is watched


class Cameras(NamedTuple):
    """The cameras of an instant: K (1, 3, 3, 3), T_world_cam (1, 3, 4, 4), (width, height)."""

    K: Tensor
    T_world_cam: Tensor
    size: tuple[int, int]


def blank_net(recipe: Recipe) -> CloudNet:
    """The network of a recipe, to be given weights."""
    return CloudNet(recipe.image, **{name: getattr(recipe, name) for name in SIZES})


@torch.no_grad()
def predicted(net: CloudNet, view: View) -> Cloud:
    """The cloud (of 1) of a view."""
    image = reduced(view.ir.astype(np.float32), net.image)
    return net(image[None, None].float() / 255)


def cloud_of(net: CloudNet, view: View) -> np.ndarray:
    """(N, 3) metres, the cloud of a view where the network puts it, in its camera's frame."""
    cloud = predicted(net, view)
    return (cloud.points[0] + cloud.t[0]).numpy()


def surface_of(view: View) -> np.ndarray:
    """(M, 3) metres, what the camera sees of head and glasses."""
    seen = np.where(headset.foreground(view), view.depth, 0)
    return depth_to_points(seen, view.K) if seen.any() else np.zeros((0, 3))


def pictures_of(net: CloudNet, recipe: Recipe, instant: list[View], given: int) -> Pictures:
    """Silhouettes and pictures (3, H, W) in all views of the cloud of one of them."""
    known = _cameras(instant)
    cloud = predicted(net, instant[given])
    loss = recipe.new_loss(known.size)
    seen = loss.projector(
        cloud.points, cloud.t, known.T_world_cam[:, given], known.K, known.T_world_cam,
        intensities=cloud.intensities, scale=cloud.scale, sigma=loss.blur[1],
    )  # fmt: skip
    return Pictures(seen.silhouette[0], seen.intensity[0])


def targets_of(recipe: Recipe, instant: list[View]) -> tuple[np.ndarray, np.ndarray]:
    """Exact masks and images within them (3, H, W), 0 to 1, as the losses compare with."""
    masks = np.stack([headset.foreground(view) for view in instant])
    images = np.stack([view.ir for view in instant]) / np.float32(255)
    width, height, _ = recipe.grid
    both = torch.from_numpy(np.stack([masks.astype(np.float32), np.where(masks, images, 0)]))
    small = F.interpolate(both.float(), size=(height, width), mode="area").numpy()
    return small[0], small[1]


def train_watched(
    recipe: Recipe, view: View, draw: Callable[[Mapping[str, np.ndarray]], Picture]
) -> tuple[CloudNet, History]:
    """A small network, trained on a few instants of the crowd that are drawn for it.

    Args:
        recipe: what is trained.
        view: whose cloud is looked at on the way.
        draw: makes a picture of its clouds so far, step -> (N, 3) metres about their place. A
            notebook shows the newest in the place of the one before.
    """
    few = Redrawn(range(choose(tiny=4, book=96, paper=96)), split=training.CROWD, scale=scale())
    triples = recipe.triples(batches.load(few, progress=False))
    stages: dict[str, np.ndarray] = {}
    every = -(-recipe.steps // STAGES)
    handle = None

    def watch(net: CloudNet) -> dict[str, float]:
        nonlocal handle
        cloud = predicted(net, view)
        stages[f"step {min(recipe.steps, every * (len(stages) + 1))}"] = cloud.points[0].numpy()
        bundle, metadata = draw(stages)._repr_mimebundle_()
        shown = {"metadata": metadata, "raw": True}
        if handle is None:
            handle = display(bundle, display_id=True, **shown)
        else:
            handle.update(bundle, **shown)
        return {"scale": float(cloud.scale)}

    net = recipe.new_net(triples)
    history = fit(
        net, recipe.batches(triples), recipe.new_loss(triples.size), steps=recipe.steps,
        device="cpu", evaluate=watch, evaluate_every=every, show=False, **recipe.fit,
    )  # fmt: skip
    return net, history


def seconds_of_a_step() -> tuple[float, float]:
    """How long a step of a training takes at the paper's sizes, and at those that are compared.

    Both of 4 instants. The time does not depend on what images show, so this scale's are enlarged.
    It does depend on blur and points, which change in a training, so that it is the mean of steps
    spread over it.
    """
    data = batches.load(Redrawn(range(4), split=training.CROWD, scale=scale()), progress=False)
    paper = RECIPES["paper"]
    large = choose(tiny=training.compared(image=(160, 94)), book=paper, paper=paper)
    small = training.compared()
    slow, quick = choose(tiny=(1, 1), book=(3, 20), paper=(3, 20))
    return _seconds(large, data, slow), _seconds(small, data, quick)


def _seconds(recipe: Recipe, data: batches.Stack, steps: int) -> float:
    """Of one step with all instants of `data`, the mean of several."""
    triples = recipe.triples(data)
    net, loss = recipe.new_net(triples), recipe.new_loss(triples.size)
    for number in (1, steps):  # the first is slower, and not counted
        start = time.perf_counter()
        some = recipe.batches(triples, steps=number, batch=len(triples))
        fit(net, some, loss, steps=number, device="cpu", show=False, **recipe.fit)
    return (time.perf_counter() - start) / steps


def off_by_axis(net: CloudNet, recipe: Recipe) -> list[float]:
    """Metres, the median error of the translation along x, y and z of the cameras."""
    data = training.triples_for(recipe, training.TEST)
    found = predict(net, data.images.flatten(0, 1)).t
    return (found - data.t.flatten(0, 1)).abs().median(0).values.tolist()


def constant_translation() -> float:
    """Metres, the median error of a translation that is always the mean of the training's."""
    train = training.stack(training.CROWD)
    rows = train.object_id < headset.HEAD
    test = training.stack(training.TEST)
    truth = test.t[test.object_id < headset.HEAD]
    return float((truth - train.t[rows].mean(0)).norm(dim=-1).median())


def ceiling(instants: int) -> float:
    """Mean overlap of visual hulls of three true masks with these masks, over some instants.

    Voxels of 6 mm. Each hull is compared in the views that it was cut out by, so that this is what
    clouds could reach that fill it, at the size of the grid.
    """
    sizes = training.recipe()
    data = training.triples_for(sizes, training.TEST)
    chosen = torch.linspace(0, len(data) - 1, instants).round().long()
    masks = training.true_masks(training.TEST, data.views[chosen])
    line = torch.arange(-0.24, 0.24, choose(tiny=0.02, book=0.006, paper=0.006))
    cube = torch.cartesian_prod(line, line, line).numpy()
    found = []
    for mask, g in zip(masks, chosen.tolist(), strict=True):
        T = data.T_world_cam[g].double().numpy()
        middle = T[0, :3, :3] @ data.t[g, 0].double().numpy() + T[0, :3, 3] + [0, 0, 0.1]
        space, inside = cube + middle, np.ones(len(cube), bool)
        pixels = []
        for j in range(len(T)):
            seen = (space - T[j, :3, 3]) @ T[j, :3, :3]
            x, y = np.round(project(data.K[g, j].double().numpy(), seen)).astype(int).T
            x, y = x.clip(0, data.size[0] - 1), y.clip(0, data.size[1] - 1)
            inside &= mask[j].numpy()[y, x]
            pixels.append((x, y))
        for j, (x, y) in enumerate(pixels):
            hull = torch.zeros(mask[j].shape)
            hull[y[inside], x[inside]] = 1
            found.append(float(overlap(hull, mask[j])))
    return float(np.mean(found))


def case(
    net: CloudNet, recipe: Recipe, numbers: Tensor, given: int
) -> tuple[np.ndarray, list, list, tuple[np.ndarray, np.ndarray]]:
    """One row of the gallery: an instant's views by their numbers in the split, and the input."""
    dataset = data_tools.open("headset", split=training.TEST)
    instant = [dataset[int(number)] for number in numbers]
    seen = pictures_of(net, recipe, instant, given).silhouette
    shape = instant[0].ir.shape
    large = F.interpolate(seen[:, None], size=shape, mode="bilinear")[:, 0] > 0.5
    pairs = [
        (headset.foreground(view), mask.numpy()) for view, mask in zip(instant, large, strict=True)
    ]
    clouds = cloud_of(net, instant[given]), surface_of(instant[given])
    return instant[given].ir, [view.ir for view in instant], pairs, clouds


def seen_and_guessed(net: CloudNet, recipe: Recipe, view: View) -> dict[str, np.ndarray]:
    """The points of a cloud by whether the camera's rays meet them first, in metres."""
    known = _cameras([view])
    cloud = predicted(net, view)
    own = known.T_world_cam[:, 0]
    projector = recipe.projector(known.size)
    voxels = projector.to_voxels(cloud.points, cloud.t, own, known.K, known.T_world_cam)[0, 0]
    met = first_met(voxels).numpy()
    points = cloud_of(net, view)
    parts = {"in the picture": points[met], "guessed": points[~met]}
    return {name: some for name, some in parts.items() if len(some)}


def _cameras(instant: list[View]) -> Cameras:
    K = torch.from_numpy(np.stack([view.K for view in instant])).float()
    T = torch.from_numpy(np.stack([view.T_world_cam for view in instant])).float()
    return Cameras(K[None], T[None], instant[0].ir.shape[::-1])
