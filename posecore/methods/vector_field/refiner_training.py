"""The training of the refiner: on predicted fields (`predictions`) and perturbed poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, fail, require_integer, require_number
from posecore.methods.vector_field.masked_fields import MaskedFields
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.models import ObjectModel, require_models
from posecore.refinement import perturb, pose_loss
from posecore.symmetry import canonical_rotation

__all__ = ["RefinerTraining"]

MAX_CENTRE_ERROR = 0.5
"""Diameters."""


class RefinerTraining:
    """Batches and loss of a refiner, from the predicted fields of a frozen network.

        seen = predict_views(net, data)  # both of `predictions`
        training = RefinerTraining(seen, refiner.models, initial_poses(system, seen))
        fit(refiner, training.batches, training.loss, steps=2000, clip=1.0)

    The fields are cached, so a batch needs no network. The initial poses are perturbed true ones
    (`perturb`), and the system's own where they are given.

    Args:
        seen: of each batch of images the network's predictions, and "object_id", "R", "t" and "K"
            of that batch, as `Stack.frames` gives them. False detections are left out.
        models: in the order of the field's network. Of a symmetric object the canonical pose is
            taken (`canonical_rotation`).
        own: of each batch of images the system's own poses (S, 3, 3) and (S, 3), one for each entry
            of its fields. Half of the initial poses are then of these, but none whose centre
            is off by half a diameter: no refinement mends that.
        size: entries in a batch.
        rotation, lateral, depth: of `perturb`.

    Attributes:
        fields: of all entries.
        entry: (S,) int64 those with a true pose.
        R, t, camera: (S, 3, 3), (S, 3), (S, 3, 3) float32, their true poses and cameras.
        made_from: what tells `fit` this training from others (`posecore.training.origins`). The
            network is named by its digest (`posecore.weights.digest`); its fields, which rounding
            moves across thresholds, differ from one machine to the next.

    Raises:
        ValueError: naming an argument that cannot be, or if nothing is left to learn from.
    """

    def __init__(
        self,
        seen: Sequence[tuple[MaskedFields, Mapping[str, Tensor]]],
        models: Sequence[ObjectModel],
        own: Sequence[tuple[Array, Array]] | None = None,
        *,
        size: int = 64,
        rotation: float = math.radians(20),
        lateral: float = 0.08,
        depth: float = 0.2,
    ) -> None:
        models = require_models(models)
        self.size = require_integer("size", size, 1)
        self.made_from = {"size": size, "rotation": rotation, "lateral": lateral, "depth": depth}
        self.sizes = {
            "rotation": require_number("rotation", rotation, 0, math.pi),
            "lateral": require_number("lateral", lateral, 0),
            "depth": require_number("depth", depth, 0),
        }
        if not seen or (own is not None and len(own) != len(seen)):
            got = f"{len(seen)} and {own if own is None else len(own)}"
            fail("seen and own", "the same number of batches, at least one", got)
        parts = [_truth(fields, batch, models) for fields, batch in seen]
        known, R, t, self.camera = (torch.cat(column) for column in zip(*parts, strict=True))
        self.fields = MaskedFields.joined([fields for fields, _ in seen], torch.float16)
        self.entry = known.nonzero()[:, 0]
        self.index = self.fields.object[self.entry]
        if not len(self.entry):
            fail("seen", "an object with a true pose", "none")
        for o, model in enumerate(models):
            if model.symmetric:
                chosen = self.index == o
                motions = torch.from_numpy(model.symmetries).float()
                R[chosen], t[chosen] = canonical_rotation(R[chosen], t[chosen], motions)
        self.R, self.t = R, t
        self.centre = torch.tensor(np.array([model.keypoints[-1] for model in models])).float()
        self.diameter = torch.tensor([model.diameter for model in models])
        self.own = None if own is None else self._usable(own)

    def _usable(self, own: Sequence[tuple[Array, Array]]) -> tuple[Tensor, Tensor, Tensor]:
        """Own poses of the S entries, and which of them are near enough to be refined."""
        R, t = (torch.cat([torch.as_tensor(part[n]) for part in own]).float() for n in (0, 1))
        if R.shape != (len(self.fields), 3, 3) or t.shape != (len(self.fields), 3):
            expected = f"poses of {len(self.fields)} entries"
            fail("own", expected, f"shapes {tuple(R.shape)} and {tuple(t.shape)}")
        R, t = R[self.entry], t[self.entry]
        centre, diameter = self.centre[self.index][..., None], self.diameter[self.index]
        gap = (R @ centre)[..., 0] + t - (self.R @ centre)[..., 0] - self.t
        return R, t, gap.norm(dim=-1) < MAX_CENTRE_ERROR * diameter

    def __len__(self) -> int:
        """How many objects there are to learn from."""
        return len(self.entry)

    def batches(self, generator: torch.Generator) -> dict[str, Tensor]:
        """A batch for `fit`, of objects drawn anew."""
        rows = torch.randint(len(self), (self.size,), generator=generator)
        index, R_gt, t_gt = self.index[rows], self.R[rows], self.t[rows]
        centre, diameter = self.centre[index], self.diameter[index]
        R, t = perturb(R_gt, t_gt, centre, diameter, generator, **self.sizes)
        if self.own is not None:
            R_own, t_own, usable = (values[rows] for values in self.own)
            usable &= torch.arange(self.size) % 2 == 0
            R[usable], t[usable] = R_own[usable], t_own[usable]
        return {
            "entry": self.entry[rows], "index": index, "camera": self.camera[rows],
            "R": R, "t": t, "R_gt": R_gt, "t_gt": t_gt,
        }  # fmt: skip

    def loss(self, refiner: FieldRefiner, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The mean of `pose_loss` over all iterations; "start" is that of the poses to begin with.

        Its points are those that the refiner looks at.
        """
        index, R_gt, t_gt = batch["index"], batch["R_gt"], batch["t_gt"]
        entry = batch["entry"]

        def error(R: Tensor, t: Tensor) -> Tensor:
            points, diameter = refiner.points[index], refiner.diameter[index]
            symmetric = refiner.symmetric[index]
            return pose_loss(points, R, t, R_gt, t_gt, diameter, symmetric).mean()

        found = refiner(
            index,
            batch["R"],
            batch["t"],
            batch["camera"],
            lambda pixels: self.fields.at(entry, pixels),
        )
        errors = [error(R, t) for R, t in found]
        with torch.no_grad():
            start = error(batch["R"], batch["t"])
        return {"loss": torch.stack(errors).mean(), "start": start, "end": errors[-1].detach()}


def _truth(
    fields: MaskedFields, batch: Mapping[str, Tensor], models: Sequence[ObjectModel]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Which of S entries are known, (S,) bool, and of those R, t and camera in float32."""
    missing = {"object_id", "R", "t", "K"} - batch.keys()
    if missing:
        fail("seen", "batches with object_id, R, t and K", f"one without {sorted(missing)}")
    places = batch["object_id"].shape
    image = torch.arange(len(batch["object_id"]))[:, None].expand(places).flatten()
    object_id, R, t = (batch[name].flatten(0, 1) for name in ("object_id", "R", "t"))
    ids = torch.tensor([model.object_id for model in models])
    same_object = ids[fields.object][:, None] == object_id
    same = same_object & (fields.image[:, None] == image)  # (S, M)
    known, row = same.nonzero(as_tuple=True)
    once = known.diff(prepend=known.new_tensor([-1])) > 0  # of two in an image, the first
    known, row = known[once], row[once]
    flags = torch.zeros(len(fields), dtype=torch.bool)
    flags[known] = True
    return flags, R[row].float(), t[row].float(), batch["K"][fields.image[known]].float()
