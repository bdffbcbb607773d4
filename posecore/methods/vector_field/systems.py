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

import numpy as np
import torch
from torch import Tensor

from posecore import cameras, poses
from posecore.arrays import Array, fail, require_choice, require_integer, require_number, to_numbers
from posecore.methods.vector_field.masked_fields import MaskedFields, look_at
from posecore.methods.vector_field.models import ObjectModel, require_models
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.voting import FITS, Votes, vote_pixels
from posecore.registration.weighted_pnp import uncertainty_pnp

__all__ = ["STAGES", "SYSTEMS", "Estimate", "ObjectModel", "VectorFieldSystem"]

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
        hypotheses: of the vote.
        seed: of the vote; the same seed gives the same poses.
        fit: of the vote, its last step: "lines" or "angles".

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
        hypotheses: int = 128,
        seed: int = 0,
        fit: str = "lines",
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
        self.hypotheses = require_integer("hypotheses", hypotheses, 1)
        self.seed = require_integer("seed", seed, 0)
        require_choice("fit", fit, FITS)
        self.fit = fit

    @classmethod
    def named(
        cls,
        name: str,
        net: VectorFieldNet,
        models: Sequence[ObjectModel],
        refiner: FieldRefiner | None = None,
        **options: float | str,
    ) -> VectorFieldSystem:
        """One of `SYSTEMS`; `options` are those of the class."""
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
        fields = look_at(self.net.eval(), images.float(), self.min_pixels)
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
        began = time.perf_counter()
        models = [self.models[int(fields.object[entry])] for entry in entries]
        votes = []
        for entry in entries.tolist():
            pixels, vectors = (part.double().cpu().numpy() for part in fields.of(entry))
            options = {"hypotheses": self.hypotheses, "seed": self.seed, "fit": self.fit}
            votes.append((pixels, vote_pixels(pixels, vectors, **options)))
        voted = time.perf_counter()
        first = [
            _first_pose(vote, pixels, model, camera.numpy())
            for (pixels, vote), model in zip(votes, models, strict=True)
        ]
        solved = time.perf_counter()
        overlaps = [
            _overlap(fields, entry, model, R, t, camera)
            for entry, model, (R, t, _) in zip(entries, models, first, strict=True)
        ]
        refined = [self._refines(share) for share in overlaps]
        final = self._refined(fields, entries, first, camera, refined)
        spent = (seconds, voted - began, solved - voted, time.perf_counter() - solved)
        return [
            Estimate(
                image=int(fields.image[entry]),
                object_id=model.object_id,
                R=R,
                t=t,
                score=float(fields.confidence[entry] * vote.inliers.mean()) if fits else 0.0,
                overlap=share,
                refined=again,
                first=(R_1, t_1),
                keypoints=vote.points,
                covariances=vote.covariances,
                seconds=dict(zip(STAGES, spent, strict=True)),
            )
            for entry, model, (R, t), share, again, (R_1, t_1, fits), (_, vote) in zip(
                entries, models, final, overlaps, refined, first, votes, strict=True
            )
        ]

    def _refines(self, share: float) -> bool:
        return self.refine == "always" or (self.refine == "overlap" and share > self.threshold)

    def _refined(
        self,
        fields: MaskedFields,
        entries: Tensor,
        first: list[tuple[np.ndarray, np.ndarray, bool]],
        camera: Tensor,
        wanted: list[bool],
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """The first poses, those that are wanted corrected, all in one go."""
        final = [(R, t) for R, t, _ in first]
        rows = [row for row, want in enumerate(wanted) if want]
        if not rows:
            return final
        chosen = entries[rows]
        R, t = (torch.from_numpy(np.stack([final[row][n] for row in rows])) for n in (0, 1))
        device = self.refiner.diameter.device
        *_, (R, t) = self.refiner(
            fields.object[chosen].to(device),
            R.to(device),
            t.to(device),
            camera.expand(len(rows), 3, 3).to(device),
            lambda pixels: fields.at(chosen, pixels),
        )
        for row, *pose in zip(rows, R.cpu().numpy(), t.cpu().numpy(), strict=True):
            final[row] = tuple(pose)
        return final


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


def _overlap(
    fields: MaskedFields, entry: Tensor, model: ObjectModel, R: Array, t: Array, camera: Tensor
) -> float:
    """`refinement.overlap` with the mask of an entry."""
    points = poses.apply(R, t, model.points)
    pixels = torch.from_numpy(cameras.project(camera.numpy(), points, behind="inf"))
    return float(fields.contains(entry[None], pixels[None]).double().mean())


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
