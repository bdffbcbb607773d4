"""The losses of the network: of masks, of vectors, and of rays that miss their keypoint."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_integer,
    require_number,
)
from posecore.methods.vector_field.fields import FieldTargets, unit

__all__ = ["VectorFieldLoss", "projection_loss", "projection_weight", "vector_loss"]

PROJECTIONS = ("none", "pixel", "unit")


@array_function(predicted="... 2", target="... 2")
def vector_loss(predicted: Array, target: Array) -> Array:
    """The loss of the vectors: smooth L1 between predicted and true ones.

    The mean over all coordinates, as PVNet has it (Peng et al., CVPR 2019; reference
    implementation zju3dv/pvnet).

    Args:
        predicted: (..., 2) vectors, any number of leading dimensions.
        target: the same shape; PVNet asks for unit vectors (`fields.unit`).

    Returns:
        A scalar; 0 for no vectors at all.

    Raises:
        ValueError: if the shapes differ.
    """
    _require_same_shape(predicted, target)
    return _smooth_l1(predicted - target)


@array_function(predicted="... 2", target="... 2")
def projection_loss(
    predicted: Array, target: Array, eps: float = 1e-3, ignore_reversed: bool = False
) -> Array:
    """The projection loss: distances of the keypoints from the rays along the predicted vectors.

    You et al., Object Pose Estimation Incorporating Projection Loss and Discriminative Refinement,
    Eq 1: smooth L1 of `g . n / |n|`, where `n` is the normal of the predicted vector `p` and `g`
    leads to the keypoint. It is a distance in pixels if `g` is in pixels, and then grows with the
    distance of the keypoint; with a `g` of length one it says what the vector loss says already.
    Print differs: a sum there, weighted by the predicted mask; here the mean over the vectors that
    are given, those of the true mask. A line has no direction: `p` and `-p` have the same loss.

    Args:
        predicted: (..., 2) vectors, any number of leading dimensions.
        target: the same shape, from the pixel to the keypoint.
        eps: predicted vectors shorter than this are divided by it instead of their length: the
            gradient of a distance is at most `|target| / eps`, and a vector of length 0 has loss 0.
        ignore_reversed: whether vectors that point away, by more than 90 degrees, have loss 0. Else
            a wall as high as the distance stands between them and the right direction, which is
            more than the vector loss climbs: they turn to point exactly the wrong way, and stay so.

    Returns:
        A scalar; 0 for no vectors at all.

    Raises:
        ValueError: if the shapes differ or `eps` is not above 0.
    """
    _require_same_shape(predicted, target)
    eps = require_number("eps", eps, above=0)
    across = target[..., 0] * predicted[..., 1] - target[..., 1] * predicted[..., 0]
    if ignore_reversed:
        across = across * ((predicted * target).sum(-1) > 0)
    return _smooth_l1(across / predicted.norm(dim=-1).clamp_min(eps))


def projection_weight(
    done: float, start: float = 0.01, end: float = 0.05, steps: int = 40
) -> float:
    """The weight of the projection loss as training goes on (Eq 2 of the same paper).

    In the paper from 0.01 to 0.05 by 0.001 every five of 200 epochs: 40 equal steps, and 0.05 only
    when all is done.

    Args:
        done: share of the training that is behind, 0 to 1.
        start, end: first and last weight.
        steps: how many steps lead from one to the other.

    Returns:
        The weight.

    Raises:
        ValueError: if `done` is not between 0 and 1, a weight is below 0 or `steps` below 1.
    """
    done = require_number("done", done, 0, 1)
    start, end = require_number("start", start, 0), require_number("end", end, 0)
    steps = require_integer("steps", steps, 1)
    # 0.29 * 100, for one, comes out a little below 29.
    return start + (end - start) * math.floor(done * steps + 1e-9) / steps


class VectorFieldLoss:
    """Masks, vectors and projections in one loss: Eq 2, `L_vf + L_seg + beta L_proj`.

    Args:
        projection: "pixel" for Eq 1 with targets in pixels, "unit" with targets of length one,
            "none" to leave it out, as PVNet does. It is measured then all the same, in pixels.
        weight: beta, a number, or "dynamic" for `projection_weight`.
        warmup: the part of the training after which the projection loss comes in; the steps of a
            dynamic weight are those of what is left. The paper wants it late, as it is too large at
            the beginning; its first step of five epochs is longer than a whole training in small.
        ignore_reversed: as for `projection_loss`.

    Raises:
        ValueError: if `projection` is unknown, `weight` is neither "dynamic" nor at least 0, or
            `warmup` is not between 0 and 1.
    """

    def __init__(
        self,
        projection: str = "pixel",
        weight: float | str = "dynamic",
        warmup: float = 0.0,
        ignore_reversed: bool = False,
    ) -> None:
        require_choice("projection", projection, PROJECTIONS)
        if isinstance(weight, str):
            require_choice("weight", weight, ("dynamic",))
        else:
            weight = require_number("weight", weight, 0)
        self.projection, self.weight = projection, weight
        self.warmup = require_number("warmup", warmup, 0, 1)
        self.ignore_reversed = bool(ignore_reversed)

    def beta(self, done: float) -> float:
        """The weight of the projection loss when so much of the training is behind."""
        if self.projection == "none" or done < self.warmup:
            return 0.0
        if self.weight != "dynamic":
            return self.weight
        return projection_weight(
            (done - self.warmup) / (1 - self.warmup) if self.warmup < 1 else 1.0
        )

    def __call__(
        self, mask: Tensor, vectors: Tensor, targets: FieldTargets, done: float
    ) -> dict[str, Tensor]:
        """The losses of a batch.

        Args:
            mask: (B, 1 + O, h, w) what the network says of each pixel: logits, background first.
            vectors: (N, K, 2) what it says at the pixels of `targets`, for the object seen there.
            targets: of `fields.field_targets`.
            done: share of the training that is behind, 0 to 1.

        Returns:
            Scalars: "loss", to be made small, and its parts "mask" (cross-entropy), "vectors" and
            "projection", before weighting.

        Raises:
            ValueError: if shapes do not fit.
        """
        labels = targets.labels
        if mask.ndim != 4 or (mask.shape[0], *mask.shape[2:]) != labels.shape:
            batch, *size = labels.shape
            expected = f"shape ({batch}, 1 + O, {', '.join(map(str, size))}) as the labels"
            fail("mask", expected, f"shape {tuple(mask.shape)}")
        if vectors.shape != targets.vectors.shape:
            expected = f"shape {tuple(targets.vectors.shape)} as the targets"
            fail("vectors", expected, f"shape {tuple(vectors.shape)}")
        of_mask = F.cross_entropy(mask.float(), labels)
        aim = unit(targets.vectors)
        of_vectors = vector_loss(vectors, aim)
        of_projection = projection_loss(
            vectors,
            aim if self.projection == "unit" else targets.vectors,
            ignore_reversed=self.ignore_reversed,
        )
        loss = of_mask + of_vectors
        beta = self.beta(done)
        if beta > 0:
            loss = loss + beta * of_projection
        return {
            "loss": loss,
            "mask": of_mask,
            "vectors": of_vectors,
            "projection": of_projection,
        }


def _smooth_l1(errors: Tensor) -> Tensor:
    """The mean; of nothing it is 0, and still part of the graph."""
    total = F.smooth_l1_loss(errors, torch.zeros_like(errors), reduction="sum")
    return total / max(1, errors.numel())


def _require_same_shape(predicted: Tensor, target: Tensor) -> None:
    if predicted.shape != target.shape:
        fail("target", f"shape {tuple(predicted.shape)} as predicted", f"{tuple(target.shape)}")
