"""The losses of P2R and P2P.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Sections 3.3, 3.4, Eq. 4.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor

from posecore.arrays import fail, require_integer, require_number
from posecore.methods.points_to_pose.network import Prediction
from posecore.nets.rotation_heads import RotationHead

__all__ = ["PoseLoss"]


@dataclass(frozen=True)
class PoseLoss:
    """L = a L_rot + b L_trans + c L_vote, each a mean over the batch.

    - L_rot: distance of the normalised quaternion to the true one. q and -q are one rotation and 2
      apart, so it is the distance to the nearer of both; the plain one, which the paper prints,
      pushes where there is nothing to push.
    - L_trans: distance of the translations.
    - L_vote: distance of votes to true keypoints, a mean over seeds and keypoints.

    What a network does not say has no part in the sum: of P2R it is a L_rot.

    Attributes:
        weights: a, b, c, as printed.
        sign_free: whether to the nearer of q and -q, for quaternions; else to the one with w >= 0.
        squared: whether distances are squared. The paper says L2 loss, which may be either.
        representation: of the network's rotation. Outputs that are no quaternion are compared as
            they are with the numbers that stand for the true rotation.
        unit: metres that count as one.
        vote_norm: 2, or 1 for the sum of absolute differences, which is VoteNet's.

    Raises:
        ValueError: for a number that is out of range, or a representation that is unknown.
    """

    weights: tuple[float, float, float] = (0.2, 0.2, 0.6)
    sign_free: bool = True
    squared: bool = False
    representation: str = "quaternion"
    unit: float = 1.0
    vote_norm: int = 2
    head: RotationHead = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.weights, tuple | list) or len(self.weights) != 3:
            fail("weights", "three numbers", repr(self.weights))
        for weight in self.weights:
            require_number("weights", weight, 0)
        require_number("unit", self.unit, above=0)
        require_integer("vote_norm", self.vote_norm, 1, 2)
        free = self.sign_free and self.representation == "quaternion"
        name = "sign_free" if free else "output"
        head = RotationHead(self.representation, name, squared=self.squared)
        object.__setattr__(self, "head", head)

    def __call__(
        self, said: Prediction, R: Tensor, t: Tensor | None = None, keypoints: Tensor | None = None
    ) -> dict[str, Tensor]:
        """The losses of a batch; "loss" is their weighted sum.

        Args:
            said: by the network.
            R: (B, 3, 3) the true rotations.
            t: (B, 3) metres, the true translations, relative to what the clouds are relative to.
            keypoints: (K, 3) metres, in the object's frame.

        Raises:
            ValueError: if something is missing or has another shape.
        """
        _require("R", R, (len(said.rotation), 3, 3))
        if not len(R):
            fail("R", "one rotation or more", "none")
        if said.t is not None:
            _require("said.t", said.t, (len(R), 3))
        parts = {"rotation": self._of_rotation(said.rotation, R)}
        if said.t is not None or said.votes is not None:
            _require("t", t, (len(R), 3))
        if said.t is not None:
            parts["translation"] = self._distance(said.t - t).mean()
        if said.votes is not None:
            _require("keypoints", keypoints, (said.votes.shape[2], 3))
            true = keypoints @ R.mT + t[:, None]  # (B, K, 3)
            parts["votes"] = self._distance(said.votes - true[:, None], self.vote_norm).mean()
        names = dict(zip(("rotation", "translation", "votes"), self.weights, strict=True))
        return {"loss": sum(names[name] * part for name, part in parts.items()), **parts}

    def _of_rotation(self, outputs: Tensor, R: Tensor) -> Tensor:
        outputs = outputs.float() if outputs.dtype == torch.bfloat16 else outputs
        if self.representation == "quaternion":
            outputs = F.normalize(outputs, dim=-1)
        return self.head.loss(outputs, R).mean()

    def _distance(self, off: Tensor, norm: int = 2) -> Tensor:
        length = torch.linalg.vector_norm(off / self.unit, norm, dim=-1)
        return length.square() if self.squared else length


def _require(name: str, value: Tensor | None, shape: tuple[int, ...]) -> None:
    got = None if value is None else tuple(value.shape)
    if got != shape:
        fail(name, f"shape {shape}", got if got is None else f"shape {got}")
