"""The three systems of the paper: from pictures to poses.

| system     | projection loss | refiner                                              |
|------------|-----------------|------------------------------------------------------|
| `OPEPL`    | in training     | never                                                |
| `OPEPL-R`  | in training     | always                                               |
| `OPEPL-DR` | in training     | where the model, projected, overlaps with its mask   |

You et al., Object Pose Estimation Incorporating Projection Loss and Discriminative Refinement.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from posecore import cameras, poses
from posecore.arrays import Array, fail, require_choice, require_integer, require_number, to_numbers
from posecore.methods.vector_field.masked_fields import MaskedFields, predict_fields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.voting import VoteOptions, Votes, vote_pixels
from posecore.models import ObjectModel, require_models
from posecore.registration.weighted_pnp import uncertainty_pnp

__all__ = ["STAGES", "SYSTEMS", "Estimate", "ObjectModel", "VectorFieldSystem", "is_refined"]

SYSTEMS = MappingProxyType({"OPEPL": "never", "OPEPL-R": "always", "OPEPL-DR": "overlap"})
"""The systems' names in the paper, and when each of them refines."""

STAGES = ("network", "voting", "pnp", "refinement")
"""What the seconds of an image are divided into."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The pose of one object in one image.

    Attributes:
        image: from 0, as the images were given.
        object_id: of the model.
        R, t: (3, 3) and (3,) float64, metres.
        score: 0 to 1: the mean probability of the mask times the mean share, over the keypoints,
            of its pixels that point at them. 0 where no pose fits, and the pose is a guess.
        overlap: share of the model's points that the first pose projects into the mask.
        refined: whether the refiner has had its say.
        first: `R` and `t` before it.
        keypoints, covariances: (K, 2) and (K, 2, 2) what the vote found, pixels.
        seconds: stage -> seconds that its image took, all objects together. Images that went
            through the network together share its time evenly.
    """

    image: int
    object_id: int
    R: np.ndarray
    t: np.ndarray
    score: float
    overlap: float
    refined: bool
    first: tuple[np.ndarray, np.ndarray]
    keypoints: np.ndarray
    covariances: np.ndarray
    seconds: dict[str, float]


class VectorFieldSystem:
    """Network, vote, PnP and refiner.

        system = VectorFieldSystem.named("OPEPL-DR", net, models, refiner)
        estimates = system.estimate(images, K)

    Args:
        net: says masks and fields, trained; its objects in the order of the models.
        models: of the objects.
        refiner: of the same models; not needed if `refine` is "never".
        refine: "never", "always", or "overlap": where the overlap is above the threshold.
        threshold: of the overlap; the paper gives none.
        min_pixels: masks with fewer are no object. Every other gets an estimate.
        voting: how keypoints are voted for; the same seed gives the same poses. None for the
            defaults.

    Raises:
        ValueError: naming an argument that cannot be.
    """

    def __init__(
        self,
        net: VectorFieldNet,
        models: Sequence[ObjectModel],
        refiner: FieldRefiner | None = None,
        refine: str = "never",
        threshold: float = 0.8,
        *,
        min_pixels: int = 20,
        voting: VoteOptions | None = None,
    ) -> None:
        self.models = require_models(models)
        if not isinstance(net, VectorFieldNet):
            fail("net", "a VectorFieldNet", type(net).__name__)
        for name, own, wanted in (
            ("objects", net.objects, len(self.models)),
            ("keypoints", net.keypoints, len(self.models[0].keypoints)),
        ):
            if own != wanted:
                fail("net", f"{wanted} {name}, which the models have", own)
        require_choice("refine", refine, list(SYSTEMS.values()))
        if refiner is None and refine != "never":
            fail("refiner", f"a FieldRefiner to refine {refine!r}", None)
        if refiner is not None:
            if not isinstance(refiner, FieldRefiner):
                fail("refiner", "a FieldRefiner", type(refiner).__name__)
            ids = [model.object_id for model in self.models]
            theirs = [model.object_id for model in refiner.models]
            if theirs != ids:
                fail("refiner", f"one of the objects {ids}, in this order", theirs)
        self.net, self.refiner, self.refine = net, refiner, refine
        self.threshold = require_number("threshold", threshold, 0, 1)
        self.min_pixels = require_integer("min_pixels", min_pixels, 1)
        if voting is not None and not isinstance(voting, VoteOptions):
            fail("voting", "a VoteOptions or None", repr(voting))
        self.voting = VoteOptions() if voting is None else voting

    @classmethod
    def named(
        cls,
        name: str,
        net: VectorFieldNet,
        models: Sequence[ObjectModel],
        refiner: FieldRefiner | None = None,
        **options: Any,
    ) -> VectorFieldSystem:
        """One of `SYSTEMS`; `options` are those of the class.

        Raises:
            ValueError: for another name; or as the class.
        """
        require_choice("name", name, list(SYSTEMS))
        return cls(net, models, refiner, SYSTEMS[name], **options)

    def estimate(self, images: Array, K: Array) -> list[Estimate]:
        """The poses of all objects that the network sees.

        Args:
            images: (B, 3, H, W) RGB, 0 to 1.
            K: (B, 3, 3) camera matrices, or (3, 3) of all.

        Returns:
            Estimates in order of the image, then of the models.

        Raises:
            ValueError: if shapes do not fit, or `K` is no camera matrix.
        """
        images = _images(images)
        camera = _cameras(K, len(images))
        began = time.perf_counter()
        fields = predict_fields(self.net.eval(), images.float(), self.min_pixels)
        seconds = (time.perf_counter() - began) / len(images)
        return self.estimate_fields(fields, camera, seconds)

    def estimate_fields(
        self, fields: MaskedFields, K: Array, seconds: float = 0.0
    ) -> list[Estimate]:
        """The poses of objects whose fields are known; the rest of `estimate`.

        Args:
            fields: objects are the network's.
            K: (B, 3, 3) camera matrices, or (3, 3) of all.
            seconds: that the network took for each image.

        Returns:
            An estimate of every entry, in its order.

        Raises:
            ValueError: if there are fewer cameras than images, or more objects than models.
        """
        if len(fields) and int(fields.object.max()) >= len(self.models):
            fail("fields", f"objects from 0 to {len(self.models) - 1}", int(fields.object.max()))
        camera = _cameras(K, int(fields.image.max()) + 1 if len(fields) else 1)
        found = []
        for image in fields.image.unique().tolist():
            entries = (fields.image == image).nonzero()[:, 0]
            found += self._of_image(fields, entries, camera[image], seconds)
        return found

    @torch.no_grad()
    def _of_image(
        self, fields: MaskedFields, entries: Tensor, camera: Tensor, seconds: float
    ) -> list[Estimate]:
        """The estimates of all objects in one image."""
        candidates = [
            _Candidate(entry, self.models[int(fields.object[entry])]) for entry in entries.tolist()
        ]
        spent = [seconds]
        for stage in (self._vote, self._solve, self._refine):
            began = time.perf_counter()
            stage(candidates, fields, camera)
            spent.append(time.perf_counter() - began)
        return [
            Estimate(
                image=int(fields.image[one.entry]),
                object_id=one.model.object_id,
                R=one.R,
                t=one.t,
                score=float(fields.confidence[one.entry] * one.votes.inliers.mean())
                if one.fits
                else 0.0,
                overlap=one.overlap,
                refined=one.refined,
                first=one.first,
                keypoints=one.votes.points,
                covariances=one.votes.covariances,
                seconds=dict(zip(STAGES, spent, strict=True)),
            )
            for one in candidates
        ]

    def _vote(self, candidates: list[_Candidate], fields: MaskedFields, camera: Tensor) -> None:
        for one in candidates:
            one.pixels, vectors = (part.double().cpu().numpy() for part in fields.of(one.entry))
            one.votes = vote_pixels(one.pixels, vectors, self.voting)

    def _solve(self, candidates: list[_Candidate], fields: MaskedFields, camera: Tensor) -> None:
        for one in candidates:
            one.R, one.t, one.fits = _first_pose(one.votes, one.pixels, one.model, camera.numpy())
            one.first = one.R, one.t

    def _refine(self, candidates: list[_Candidate], fields: MaskedFields, camera: Tensor) -> None:
        """Correct the poses that are to be corrected, all in one go."""
        for one in candidates:
            one.overlap = _overlap(fields, one, camera)
            one.refined = is_refined(self.refine, one.overlap, self.threshold)
        chosen = [one for one in candidates if one.refined]
        if not chosen:
            return
        entries = torch.tensor([one.entry for one in chosen])
        device = self.refiner.diameter.device
        *_, (R, t) = self.refiner(
            fields.object[entries].to(device),
            torch.from_numpy(np.stack([one.R for one in chosen])).to(device),
            torch.from_numpy(np.stack([one.t for one in chosen])).to(device),
            camera.expand(len(chosen), 3, 3).to(device),
            lambda pixels: fields.at(entries, pixels),
        )
        for one, *pose in zip(chosen, R.cpu().numpy(), t.cpu().numpy(), strict=True):
            one.R, one.t = pose


@dataclass
class _Candidate:
    """An object in an image on its way to an `Estimate`; each stage adds what it finds."""

    entry: int
    model: ObjectModel
    pixels: np.ndarray | None = None
    votes: Votes | None = None
    R: np.ndarray | None = None
    t: np.ndarray | None = None
    fits: bool = False
    first: tuple[np.ndarray, np.ndarray] | None = None
    overlap: float = 0.0
    refined: bool = False


def is_refined(refine: str, overlap: float, threshold: float) -> bool:
    """Whether a system refines a first pose (Section III-D).

    Args:
        refine: "never", "always", or "overlap": where the overlap is above the threshold.
        overlap: share of the model's points that the pose projects into the mask.
        threshold: of the overlap.
    """
    return refine == "always" or (refine == "overlap" and overlap > threshold)


def _first_pose(
    vote: Votes, pixels: np.ndarray, model: ObjectModel, camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Rotation, translation, and whether they are more than a guess."""
    try:
        found = uncertainty_pnp(model.keypoints, vote.points, vote.covariances, camera)
        return found.R, found.t, True
    except ValueError:  # keypoints on one line, or none in front of the camera
        pass
    # As far away as an object must be to be as large as the mask, unturned.
    low, high = pixels.min(0), pixels.max(0)
    middle = np.append((low + high) / 2, 1)
    depth = camera[1, 1] * model.diameter / np.linalg.norm(high - low + 1)
    centre = abs(depth) * np.linalg.solve(camera, middle)
    return np.eye(3), centre - model.keypoints[-1], False


def _overlap(fields: MaskedFields, one: _Candidate, camera: Tensor) -> float:
    """`refinement.overlap` with the mask of an entry."""
    points = poses.apply(one.R, one.t, one.model.points)
    pixels = torch.from_numpy(cameras.project(camera.numpy(), points, behind="inf"))
    inside = fields.contains(torch.tensor([one.entry]), pixels[None])
    return float(inside.double().mean())


def _images(images: Array) -> Tensor:
    images = torch.as_tensor(images)
    if images.ndim != 4 or images.shape[1] != 3 or not images.numel():
        fail("images", "shape (B, 3, H, W), none of them 0", f"shape {tuple(images.shape)}")
    low, high = (float(value) for value in images.aminmax())
    # What filters overshoot is no mistake, 255 is one; NaN fails both comparisons.
    if not images.is_floating_point() or not (low > -0.5 and high < 1.5):
        fail("images", "floats from 0 to 1", f"{images.dtype} from {low} to {high}")
    return images


def _cameras(K: Array, count: int) -> Tensor:
    """(count, 3, 3) float64."""
    camera = torch.from_numpy(to_numbers("K", K))
    if camera.shape != (3, 3) and (
        camera.ndim != 3 or camera.shape[1:] != (3, 3) or len(camera) < count
    ):
        fail("K", f"shape (3, 3) or ({count}, 3, 3)", f"shape {tuple(camera.shape)}")
    cameras.require_intrinsics("K", camera)
    return camera.expand(count, 3, 3) if camera.ndim == 2 else camera
