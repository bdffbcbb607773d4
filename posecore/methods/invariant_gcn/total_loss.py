"""The sum of the losses of the rotation-invariant paper, Eq. 7, 12, 17 and 18."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from posecore.arrays import fail, require_choice, require_number
from posecore.methods.invariant_gcn import losses
from posecore.methods.invariant_gcn.axes import rotation_from_axes
from posecore.methods.invariant_gcn.faces import voted_faces
from posecore.methods.invariant_gcn.network import Prediction

__all__ = ["TotalLoss"]

LEAST = 1e-4  # of a confidence as a weight: some point has to say where a face is
Add = Callable[[str, float, Tensor], None]
"""Of a part by its name, with its weight."""


@dataclass(frozen=True)
class TotalLoss:
    """L = l_Basic L^Basic + l_PC L^PC + l_BB L^BB (Eq. 18), of the branches that a network has.

    - L^Basic = l_rot (Eq. 4) + l_trans (Eq. 5) + l_size (Eq. 6): Eq. 7.
    - L^PC: Eq. 8 of the points that were seen, and of those that the second branch says; with the
      confidences of these and the proportions of the box, which are not in the paper.
    - L^BB = Eq. 10 + (l_R Eq. 13 + l_t Eq. 14 + l_s Eq. 15) + Eq. 16: Eq. 17 and 12; and the L1
      loss on n and d, which the text announces. Of a network without faces it is Eq. 16 alone.

    Attributes:
        basic, pc, bb: l_Basic, l_PC, l_BB; 8, 1, 1 are printed.
        rotation, translation, size: l_rot, l_trans, l_size; 1 each are printed.
        plane_rotation, plane_translation, plane_size: the three of Eq. 12, which are not.
        faces: weight of the L1 loss on n and d; 0 for Eq. 17 as printed.
        consistency, reconstruction: weights of both readings of Eq. 8.
        confidence, proportions: weights of what the paper has not.
        a, b: of Eq. 10 and 16.
        squared, detach: of Eq. 10 and 16, as in `losses`.
        reduction: "mean" or "sum" over points and faces.
        unit: metres that count as one in Eq. 5, 6, 8, 14 and 15.
        skip_symmetric: whether the x axis of symmetric things is not asked. Their poses are turned
            so that there is an answer, if one wants to ask.

    Raises:
        ValueError: for a number that is out of range.
    """

    basic: float = 8.0
    pc: float = 1.0
    bb: float = 1.0
    rotation: float = 1.0
    translation: float = 1.0
    size: float = 1.0
    plane_rotation: float = 1.0
    plane_translation: float = 1.0
    plane_size: float = 1.0
    faces: float = 1.0
    consistency: float = 1.0
    reconstruction: float = 1.0
    confidence: float = 0.1
    proportions: float = 1.0
    a: float = 1 / 303.5
    b: float = 13.7
    squared: bool = True
    detach: bool = True
    reduction: str = "mean"
    unit: float = 1.0
    skip_symmetric: bool = True

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, float | int) and not isinstance(value, bool):
                require_number(name, value, 0)
        for name in ("a", "b", "unit"):
            require_number(name, getattr(self, name), above=0)
        require_choice("reduction", self.reduction, losses.REDUCTIONS)

    def __call__(self, said: Prediction, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch; "loss" is their sum, each part is there without its weights.

        Args:
            said: by the network.
            batch: "points" (B, N, 3), "R" (B, 3, 3), "t", "size" (B, 3), "canonical" (B, N, 3),
                "symmetric" (B,), by `CategoryClouds.draw`.

        Raises:
            ValueError: if something has another shape.
        """
        self._check(said, batch)
        symmetric = batch["symmetric"]
        if not self.skip_symmetric:
            symmetric = torch.zeros_like(symmetric)
        parts: dict[str, Tensor] = {}
        weights: dict[str, float] = {}

        def add(name: str, weight: float, part: Tensor) -> None:
            if weight:
                parts[name], weights[name] = part, weight

        R = None
        if said.x is not None:
            self._add_basic(add, said, batch, symmetric)
            R = self._rotation(said, batch["R"], symmetric)
            seen = batch["points"], R, said.t, batch["canonical"]
            far = losses.consistency_loss(*seen, self.reduction) / self.unit
            add("consistency", self.pc * self.consistency, far)
        if said.canonical is not None:
            self._add_points(add, said, batch)
        if said.face_normals is not None:
            self._add_faces(add, said, batch, R, symmetric)
        total = sum(weights[name] * part for name, part in parts.items())
        return {"loss": total, **parts}

    def _add_basic(
        self, add: Add, said: Prediction, batch: Mapping[str, Tensor], symmetric: Tensor
    ) -> None:
        R, t, size = batch["R"], batch["t"], batch["size"]
        add("rotation", self.basic * self.rotation, losses.axis_loss(said.x, said.y, R, symmetric))
        far = losses.translation_loss(said.t, t) / self.unit
        add("translation", self.basic * self.translation, far)
        add("size", self.basic * self.size, losses.size_loss(said.size, size) / self.unit)
        sure = losses.confidence_loss(
            said.x, said.y, said.x_confidence, said.y_confidence, R, symmetric,
            b=self.b, detach=self.detach,
        )  # fmt: skip
        add("axis_confidence", self.bb, sure)

    def _add_points(self, add: Add, said: Prediction, batch: Mapping[str, Tensor]) -> None:
        canonical, size = batch["canonical"], batch["size"]
        off = losses.reconstruction_loss(said.canonical, canonical, size, self.reduction)
        add("reconstruction", self.pc * self.reconstruction, off)
        sure = losses.canonical_loss(said.canonical, said.canonical_confidence, canonical, size)
        add("point_confidence", self.pc * self.confidence, sure)
        true = torch.nn.functional.normalize(size, dim=-1)
        wrong = (said.proportions - true).abs().sum(-1).mean()
        add("proportions", self.pc * self.proportions, wrong)

    def _add_faces(
        self, add: Add, said: Prediction, batch: Mapping[str, Tensor], R: Tensor | None,
        symmetric: Tensor,
    ) -> None:  # fmt: skip
        votes = said.face_normals, said.face_distances
        truth = batch["points"], batch["R"], batch["t"], batch["size"]
        sure = losses.face_confidence_loss(
            *votes, said.face_confidences, *truth, a=self.a, squared=self.squared,
            detach=self.detach, reduction=self.reduction,
        )  # fmt: skip
        add("face_confidence", self.bb, sure)
        off = losses.face_loss(*votes, *truth, self.unit, self.reduction)
        add("faces", self.bb * self.faces, off)
        if R is None:  # nothing that the planes could agree with
            return
        planes = voted_faces(batch["points"], *votes, said.face_confidences.clamp(min=LEAST))
        wrong = losses.plane_normal_loss(planes, R, symmetric, self.reduction)
        add("plane_rotation", self.bb * self.plane_rotation, wrong)
        middle = losses.centre_plane_loss(planes, said.t, self.reduction) / self.unit
        add("plane_translation", self.bb * self.plane_translation, middle)
        wide = losses.size_plane_loss(planes, said.t, said.size, self.reduction) / self.unit
        add("plane_size", self.bb * self.plane_size, wide)

    def _rotation(self, said: Prediction, R: Tensor, symmetric: Tensor) -> Tensor:
        """(B, 3, 3) of the axes; of symmetric things the true x axis stands in."""
        x = torch.where(symmetric[:, None], R[:, :, 0], said.x)
        c_x = torch.where(symmetric, 0.0, said.x_confidence)
        return rotation_from_axes(x, said.y, c_x.detach(), said.y_confidence.detach())

    def _check(self, said: Prediction, batch: Mapping[str, Tensor]) -> None:
        b, n = batch["points"].shape[:2]
        shapes = {
            "points": (b, n, 3), "R": (b, 3, 3), "t": (b, 3), "size": (b, 3),
            "canonical": (b, n, 3), "symmetric": (b,),
        }  # fmt: skip
        for name, shape in shapes.items():
            if batch[name].shape != shape:
                fail(name, f"shape {shape}", f"shape {tuple(batch[name].shape)}")
        if batch["symmetric"].dtype != torch.bool:
            fail("symmetric", "booleans", batch["symmetric"].dtype)
        if all(part is None for part in said):
            fail("said", "one branch or more", "none")
