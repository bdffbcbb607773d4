"""Fields of vectors: from every pixel of an object to its keypoints in the picture.

K keypoints, O objects that the network knows. Pixels are (x, y), the first one's centre at (0, 0).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from posecore import cameras, poses
from posecore.arrays import Array, array_function, fail, require_integer
from posecore.symmetry import canonical_rotation

__all__ = ["FieldTargets", "field_targets", "keypoint_vectors", "project_keypoints", "unit"]

SHORTEST = 1e-6
"""Pixels; a vector shorter than this has no direction."""

PARTS = ("instance", "K", "object_id", "R", "t")
"""What targets are made of."""


@array_function(pixels="... P 2", keypoints="... K 2")
def keypoint_vectors(pixels: Array, keypoints: Array) -> Array:
    """The vectors from each pixel to each keypoint.

    Args:
        pixels: (..., P, 2) x, y.
        keypoints: (..., K, 2) x, y.

    Returns:
        (..., P, K, 2) in pixels.
    """
    return keypoints[..., None, :, :] - pixels[..., :, None, :]


@array_function(vectors="... 2")
def unit(vectors: Array) -> Array:
    """Vectors of length one in the same directions.

    Shorter ones than 1e-6 count as none: they go to zero as they shrink, and gradients stay finite.

    Args:
        vectors: (..., 2).

    Returns:
        (..., 2).
    """
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp_min(SHORTEST)


@array_function(keypoints="... K 3", R="... 3 3", t="... 3", camera="... 3 3")
def project_keypoints(keypoints: Array, R: Array, t: Array, camera: Array) -> Array:
    """The projections of the keypoints of posed objects, visible or not.

    Args:
        keypoints: (..., K, 3) in the object's frame, metres.
        R, t: (..., 3, 3) and (..., 3), from object to camera.
        camera: (..., 3, 3) camera matrix.

    Returns:
        (..., K, 2) pixels.

    Raises:
        ValueError: if `camera` is no camera matrix, or a keypoint is not in front of it.
    """
    return cameras.project(camera, poses.apply(R, t, keypoints))


class FieldTargets(NamedTuple):
    """The training targets of a batch: the class of every pixel, and vectors at sampled pixels."""

    labels: Tensor
    """(B, h, w) int64: 0 for the background, 1 + o for object o of the network."""
    image: Tensor
    """(N,) int64, in which image each of the N chosen pixels is."""
    y: Tensor
    """(N,) int64, its row."""
    x: Tensor
    """(N,) int64, its column."""
    object: Tensor
    """(N,) int64, the network's number o of the object that is seen there."""
    vectors: Tensor
    """(N, K, 2) from the pixel to each keypoint of that object, in pixels."""


@torch.no_grad()
def field_targets(
    batch: Mapping[str, Tensor],
    keypoints: Array,
    object_ids: Sequence[int],
    symmetries: Sequence[Array | None] | None = None,
    pixels_per_object: int | None = 256,
) -> FieldTargets:
    """The targets of a batch of images.

    The vectors of neighbouring pixels teach almost the same, and a loss over all of them can cost
    more than the network. So only some pixels are drawn, from each object that is seen, however
    small, by PyTorch's global generator: the same seed gives the same pixels.

    Args:
        batch: tensors by name, as the batches of `data_tools` have them: "instance" (B, h, w),
            which of the M objects of an image is seen, or -1; of these "object_id" (B, M), "R"
            (B, M, 3, 3) and "t" (B, M, 3); "K" (B, 3, 3), the camera matrices.
        keypoints: (O, K, 3) of each object of the network, in its frame.
        object_ids: O different numbers, the objects of the network in its order. All others are
            background.
        symmetries: of each object (S, 4, 4) or None, for `canonical_rotation`.
        pixels_per_object: at most that many of each object in each image; None for all.

    Returns:
        `FieldTargets`, its N pixels in the order of the image. N is 0 where no object is seen.

    Raises:
        ValueError: for the argument at fault: something missing in `batch`, lists of another length
            than `object_ids`, an object seen though a keypoint of it is behind the camera.
    """
    _require_batch(batch)
    R, t = batch["R"].flatten(0, 1), batch["t"].flatten(0, 1)
    camera, instance, ids = batch["K"], batch["instance"], batch["object_id"]
    keypoints = torch.as_tensor(keypoints, dtype=R.dtype, device=R.device)
    object_ids = _require_ids(object_ids)
    if keypoints.ndim != 3 or len(keypoints) != len(object_ids) or keypoints.shape[-1] != 3:
        expected = f"shape ({len(object_ids)}, K, 3), a row for each of object_ids"
        fail("keypoints", expected, f"shape {tuple(keypoints.shape)}")
    if symmetries is None:
        symmetries = [None] * len(object_ids)
    if len(symmetries) != len(object_ids):
        fail("symmetries", f"{len(object_ids)} as object_ids", len(symmetries))

    known = ids[..., None] == torch.tensor(object_ids, device=ids.device)  # (B, M, O)
    label = torch.where(known.any(-1), 1 + known.int().argmax(-1), 0)  # (B, M)
    table = torch.cat([label, label.new_zeros(len(label), 1)], 1)  # of instance -1: the background
    places = torch.where(instance < 0, ids.shape[1], instance).flatten(1)
    labels = table.gather(1, places).view_as(instance)
    image, y, x = labels.nonzero(as_tuple=True)
    row = image * ids.shape[1] + instance[image, y, x]  # the object that each pixel shows
    if pixels_per_object is not None:
        most = require_integer("pixels_per_object", pixels_per_object, 1)
        drawn = _draw(row, ids.numel(), most)
        image, y, x, row = image[drawn], y[drawn], x[drawn], row[drawn]

    seen, position = row.unique(return_inverse=True)
    number = label.flatten()[seen] - 1
    R, t = _canonical_poses(R[seen], t[seen], number, symmetries)
    aims = project_keypoints(keypoints[number], R, t, camera[seen // max(1, ids.shape[1])])
    pixels = torch.stack([x, y], -1).to(R.dtype)
    vectors = keypoint_vectors(pixels[:, None], aims[position])[:, 0]
    return FieldTargets(labels, image, y, x, number[position], vectors)


def _canonical_poses(
    R: Tensor, t: Tensor, number: Tensor, symmetries: Sequence[Array | None]
) -> tuple[Tensor, Tensor]:
    R, t = R.clone(), t.clone()
    for o, motions in enumerate(symmetries):
        chosen = number == o
        if motions is not None:
            motions = torch.as_tensor(motions, dtype=R.dtype, device=R.device)
            R[chosen], t[chosen] = canonical_rotation(R[chosen], t[chosen], motions)
    return R, t


def _draw(row: Tensor, rows: int, most: int) -> Tensor:
    """Which of the entries of `row` to keep: at most `most` of each value, ascending indices."""
    count = torch.bincount(row, minlength=rows)
    # Half of a random number, because a whole one near 1 could be rounded up to the next row.
    order = torch.argsort(row + torch.rand(len(row), device=row.device) / 2)
    first = count.cumsum(0) - count
    rank = torch.arange(len(row), device=row.device) - first[row[order]]
    return order[rank < most].sort().values


def _require_batch(batch: Mapping[str, Tensor]) -> None:
    """Refuse a batch that lacks what targets are made of; the geometry looks at its numbers."""
    missing = [name for name in PARTS if name not in batch]
    if missing:
        fail("batch", f"{', '.join(missing)} in it", ", ".join(batch) or "nothing")
    if batch["instance"].ndim != 3:
        fail("batch['instance']", "shape (B, h, w)", f"shape {tuple(batch['instance'].shape)}")
    if batch["object_id"].ndim != 2:
        got = f"shape {tuple(batch['object_id'].shape)}"
        fail("batch['object_id']", "shape (B, M)", got)
    B, M = len(batch["instance"]), batch["object_id"].shape[1]
    shapes = {"K": (B, 3, 3), "object_id": (B, M), "R": (B, M, 3, 3), "t": (B, M, 3)}
    for name, shape in shapes.items():
        if batch[name].shape != shape:
            fail(f"batch[{name!r}]", f"shape {shape}", f"shape {tuple(batch[name].shape)}")
    low, high = batch["instance"].aminmax() if batch["instance"].numel() else (-1, -1)
    if low < -1 or high >= M:
        expected = f"numbers from -1 to {M - 1}"
        fail("batch['instance']", expected, f"values from {int(low)} to {int(high)}")


def _require_ids(object_ids: Sequence[int]) -> list[int]:
    numbers = [require_integer("object_ids", number) for number in object_ids]
    if not numbers or len(set(numbers)) < len(numbers):
        fail("object_ids", "different numbers, at least one", numbers)
    return numbers
