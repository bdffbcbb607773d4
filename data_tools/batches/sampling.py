"""From rows of a dataset to a batch: cut, composed, seen by a sensor, and labelled anew."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from data_tools.batches.augmentation import Augmentation, Draws
from data_tools.batches.compositing import Layers, add_occluder, replace_background
from data_tools.batches.decoding import NONE, OUTSIDE
from data_tools.batches.sensing import degrade_depth, simulate_sensor
from data_tools.batches.table import Table
from data_tools.batches.warps import resample, turned_crop
from posecore.arrays import fail

__all__ = ["make_batch"]

T = TypeVar("T")
Each = Callable[[Callable[[int], T]], list[T]]


def make_batch(
    stack: Table,
    views: Tensor,
    boxes: np.ndarray,
    size: tuple[int, int],
    rows: Tensor,
    image: Tensor,
    cut_outs: bool,
    augment: Augmentation | None,
    generator: torch.Generator | None,
) -> dict[str, Tensor]:
    """A batch as `Stack.frames` describes it.

    Args:
        stack: the data.
        views: (B,) which images.
        boxes: (B, 4) what is cut out of them, before it is varied.
        size: (width, height) of the result.
        rows: (M,) the objects that are labelled.
        image: (M,) in which of the B images each of them is.
        cut_outs: whether occluders may be objects; where all objects are labelled they may not.
        augment, generator: as for `Stack.frames`.
    """
    draws = _draw(stack, len(views), augment, generator)
    stack.check(views)
    turn = np.zeros(len(views))
    if draws is not None:
        turn, sides = draws.turn, boxes[:, 2:]
        middle = boxes[:, :2] + (0.5 + draws.shift) * sides
        sides = sides / draws.zoom[:, None]
        boxes = np.concatenate([middle - sides / 2, sides], 1)
    to_new, K, Rz = turned_crop(stack.K[views].numpy(), boxes, turn, size)

    def each(function: Callable[[int], T]) -> list[T]:
        # OpenCV and NumPy let go of Python's lock while they work.
        with ThreadPoolExecutor(min(torch.get_num_threads(), len(views))) as threads:
            return list(threads.map(function, range(len(views))))

    layers = each(lambda i: _cut(stack, int(views[i]), to_new[i], size))
    if draws is not None and augment.background + augment.occluder > 0:
        layers = _compose(stack, layers, rows, image, cut_outs, augment, draws, each)

    batch = _labels(stack, views, rows, image, K, Rz)
    for kind in layers[0].colours:
        shape = layers[0].colours[kind].shape
        colours = np.empty((len(views), *shape), np.float32)
        each(lambda i, k=kind, out=colours: simulate_sensor(layers[i].colours[k], draws, i, out[i]))
        batch[kind] = torch.from_numpy(colours).permute(0, 3, 1, 2)
    if layers[0].depth is not None:
        metres = np.stack([layer.depth for layer in layers]) * np.float32(stack.depth_step)
        if draws is not None:
            each(lambda i: degrade_depth(metres[i], draws, i))
        batch["depth"] = torch.from_numpy(metres)
    if "instance" in stack.kinds:
        instance = np.stack([layer.instance for layer in layers])
        area = np.abs(np.linalg.det(to_new))
        batch |= _seen(stack, instance, rows, image, torch.from_numpy(area))
    if "surface" in stack.kinds:
        coordinates = np.zeros((len(views), size[1], size[0], 3), np.float32)
        first = np.searchsorted(image.numpy(), np.arange(len(views) + 1))

        def locate(index: int) -> None:
            steps = resample(stack.image("surface", int(views[index])), to_new[index], size, 0)
            for row in rows[first[index] : first[index + 1]].tolist():
                known = (layers[index].instance == int(stack.slot[row])) & (steps > 0)
                z = steps[known] * stack.depth_step
                R, t = Rz[index] @ stack.R[row].numpy(), Rz[index] @ stack.t[row].numpy()
                coordinates[index][known] = _locate(known, z, K[index], R, t)

        each(locate)
        batch["coordinates"] = torch.from_numpy(coordinates)
    return batch


def _draw(
    stack: Table, count: int, augment: Augmentation | None, generator: torch.Generator | None
) -> Draws | None:
    if augment is None:
        return None
    if not isinstance(augment, Augmentation):
        fail("augment", "an Augmentation or None", repr(augment))
    if not isinstance(generator, torch.Generator):
        fail("generator", "a torch.Generator to go with augment", repr(generator))
    if "instance" not in stack.kinds and augment.background + augment.occluder > 0:
        fail("augment", "background=0 and occluder=0, as masks are not known", augment)
    return augment.draw(count, int(torch.randint(2**62, (), generator=generator)))


def _cut(stack: Table, view: int, to_new: np.ndarray, size: tuple[int, int]) -> Layers:
    """The images of a view in other pixels."""
    known = "instance" in stack.kinds
    instance = stack.image("instance", view) if known else np.full(stack.size[::-1], NONE, np.uint8)
    instance = resample(instance, to_new, size, OUTSIDE)
    outside = instance == OUTSIDE
    colours = {}
    for kind in ("rgb", "ir"):
        if kind in stack.kinds:
            image = resample(stack.image(kind, view), to_new, size)
            image[outside] = 0
            colours[kind] = image.reshape(*image.shape[:2], -1)
    depth = None
    if "depth" in stack.kinds:
        depth = resample(stack.image("depth", view), to_new, size, 0)
    return Layers(colours, depth, instance)


def _compose(
    stack: Table,
    layers: list[Layers],
    rows: Tensor,
    image: Tensor,
    cut_outs: bool,
    augment: Augmentation,
    draws: Draws,
    each: Each,
) -> list[Layers]:
    """Other backgrounds behind objects, and things in front of them."""
    slots, kinds = stack.slot[rows].numpy(), stack.kind[rows].numpy()
    first = np.searchsorted(image.numpy(), np.arange(len(layers) + 1))

    def compose(index: int) -> Layers:
        result, partner = layers[index].copy(), int(draws.partner[index])
        other = layers[partner] if partner != index else None
        rng = np.random.default_rng(draws.seed[index, 0])
        if augment.background:
            replace_background(result, other, not draws.background[index], rng)
        labelled = range(first[index], first[index + 1])
        if draws.occluder[index] and labelled:
            target = int(rng.choice(labelled))
            cut_out = None
            # An object of the same kind in front would be one without a label.
            if cut_outs and kinds[partner] != kinds[target]:
                cut_out = int(slots[partner])
            add_occluder(result, int(slots[target]), other, cut_out, augment.keep, rng)
        return result

    return each(compose)


def _labels(
    stack: Table, views: Tensor, rows: Tensor, image: Tensor, K: np.ndarray, Rz: np.ndarray
) -> dict[str, Tensor]:
    """What does not depend on pixels."""
    turn = torch.from_numpy(Rz)
    batch = {"view": views, "group": stack.group[views], "K": torch.from_numpy(K).float()}
    if stack.T_world_cam is not None:
        T = stack.T_world_cam[views].clone()
        T[:, :3, :3] = T[:, :3, :3] @ turn.mT  # X_world = T X_old = T Rz^T X_new
        batch["T_world_cam"] = T.float()
    batch |= {"image": image, "row": rows, "object_id": stack.object_id[rows]}
    if stack.category is not None:
        batch["category"] = stack.category[rows]
    batch["R"] = (turn[image] @ stack.R[rows]).float()
    batch["t"] = (turn[image] @ stack.t[rows, :, None])[..., 0].float()
    if stack.object_size is not None:
        batch["size"] = stack.object_size[rows].float()
    return batch


def _seen(
    stack: Table, instance: np.ndarray, rows: Tensor, image: Tensor, area: Tensor
) -> dict[str, Tensor]:
    """What of each object is seen: its pixels, their box, and their share of the silhouette.

    Args:
        stack: the data.
        instance: (B, h, w) the object in each pixel, counted in its view.
        rows, image: as for `make_batch`.
        area: (B,) new pixels for each old one, by which silhouettes grow.
    """
    row_of = np.full((len(instance), 256), -1, np.int64)
    slots = stack.slot[rows].numpy()
    row_of[image.numpy(), slots] = np.arange(len(rows))
    result = {"instance": torch.from_numpy(np.stack(list(map(np.take, row_of, instance))))}
    box, pixels = np.zeros((len(rows), 4), np.float32), np.zeros(len(rows))
    for row, (index, slot) in enumerate(zip(image.tolist(), slots, strict=True)):
        mask = instance[index] == slot
        x, y = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
        if len(x):
            box[row] = x[0], y[0], x[-1] - x[0] + 1, y[-1] - y[0] + 1
            pixels[row] = np.count_nonzero(mask)
    result["box"] = torch.from_numpy(box)
    if stack.full_pixels is not None:
        full = (stack.full_pixels[rows] * area[image]).clamp(min=1)
        result["visible_fraction"] = (torch.from_numpy(pixels) / full).clamp(max=1).float()
    return result


def _locate(
    mask: np.ndarray, z: np.ndarray, K: np.ndarray, R: np.ndarray, t: np.ndarray
) -> np.ndarray:
    """Where each pixel of a mask lies on an object, by its exact depth and the pose."""
    y, x = np.nonzero(mask)
    points = np.stack([x * z, y * z, z], 1) @ np.linalg.inv(K).T
    return (points - t) @ R  # R^T (X - t)
