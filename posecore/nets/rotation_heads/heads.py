"""One interface to every way in which a network may say a rotation, chosen by name.

    head = RotationHead("6d", loss="geodesic")
    layer = nn.Linear(256, head.size)
    loss = head.loss(layer(features), R_gt).mean()  # in training
    R = head.decode(layer(features))                # at test time

Two choices are made apart from each other, so that they can be crossed:

| representation | size | target of the loss `output`                               | continuous |
|----------------|------|-----------------------------------------------------------|------------|
| `quaternion`   | 4    | w >= 0; at half turns the first other entry not 0 is > 0  | no         |
| `axis_angle`   | 3    | up to pi long; at half turns the first entry not 0 is > 0 | no         |
| `euler`        | 3    | yaw, pitch, roll; pitch to +-pi/2, where roll is 0        | no         |
| `6d`           | 6    | the first two columns of R                                | yes        |
| `procrustes`   | 9    | R itself                                                  | yes        |
| `learnable`    | 9    | what a trained codec says, Encoder_rot(R)                 | yes        |

| loss        | the distance of                                                                |
|-------------|--------------------------------------------------------------------------------|
| `output`    | the outputs to the target, as they are: the paper's loss in Euclidean space    |
| `sign_free` | the outputs to the nearer of the quaternions q and -q, which are one rotation  |
| `chordal`   | the decoded rotation to the true one: the Frobenius norm of their difference   |
| `geodesic`  | the decoded rotation to the true one: the angle between them, in radians       |

`procrustes` and `learnable` decode alike. With a loss on the decoded rotation they are the same
thing: the codec is nothing but another target.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from posecore.arrays import Array, array_function, fail, require_choice
from posecore.nets.rotation_heads import decoders
from posecore.nets.rotation_heads.codec import RotationCodec
from posecore.rotations import (
    matrix_to_axis_angle,
    matrix_to_euler,
    matrix_to_quaternion,
    matrix_to_rotation_6d,
    require_rotation,
)
from posecore.rotations.so3 import relative_angle

__all__ = ["LOSSES", "REPRESENTATIONS", "RotationHead"]

LOSSES = ("output", "sign_free", "chordal", "geodesic")
"""The losses of the table above; `sign_free` is for quaternions only."""


@array_function(R="... 3 3")
def _nine_numbers(R: Array) -> Array:
    require_rotation("R", R)
    return R.flatten(-2)


_FORMULAS: dict[str, tuple[int, Callable[[Any], Any], Callable[[Any], Any] | None]] = {
    "quaternion": (4, decoders.decode_quaternion, matrix_to_quaternion),
    "axis_angle": (3, decoders.decode_axis_angle, matrix_to_axis_angle),
    "euler": (3, decoders.decode_euler, matrix_to_euler),
    "6d": (6, decoders.decode_6d, matrix_to_rotation_6d),
    "procrustes": (9, decoders.decode_procrustes, _nine_numbers),
    "learnable": (9, decoders.decode_procrustes, None),  # its codec encodes
}

REPRESENTATIONS = tuple(_FORMULAS)
"""The representations of the table above."""


class RotationHead(nn.Module):
    """From a network's outputs to rotations, and from true rotations to a loss.

    A module, so that a codec moves to a device and into checkpoints with the network it serves. It
    has nothing to train; the codec is frozen.

    Attributes:
        size: how many numbers the network has to say.

    Args:
        representation: one of `REPRESENTATIONS`.
        loss: one of `LOSSES`; by default `output` for `learnable` (CIPE's Eq. 10), else `chordal`.
        squared: whether the loss is the square of the distance. Eq. 10 has the distance itself.
        codec: from `train_codec` or `load_codec`, for `learnable` and only for it.

    Raises:
        ValueError: if a name is unknown, `sign_free` is asked of what is no quaternion, or `codec`
            is missing or has no use.
    """

    def __init__(
        self,
        representation: str,
        loss: str | None = None,
        *,
        squared: bool = False,
        codec: RotationCodec | None = None,
    ) -> None:
        super().__init__()
        require_choice("representation", representation, REPRESENTATIONS)
        learnable = representation == "learnable"
        if loss is None:
            loss = "output" if learnable else "chordal"
        require_choice("loss", loss, LOSSES)
        if loss == "sign_free" and representation != "quaternion":
            fail("loss", f"one that {representation!r} has", "'sign_free', which is of quaternions")
        if not isinstance(codec, RotationCodec if learnable else type(None)):
            expected = "a trained RotationCodec" if learnable else "None"
            fail("codec", f"{expected} for {representation!r}", type(codec).__name__)
        self.representation = representation
        self.size = _FORMULAS[representation][0]
        self.loss_name = loss
        self.squared = bool(squared)
        self.codec = None if codec is None else codec.requires_grad_(False)

    def forward(self, outputs: Tensor) -> Tensor:
        """`decode`, as modules have it."""
        return self.decode(outputs)

    def decode(self, outputs: Array) -> Array:
        """The rotation that the outputs stand for; a rotation for any finite outputs.

        Args:
            outputs: (..., size).

        Returns:
            (..., 3, 3) rotation; in float32 where the outputs have half precision.

        Raises:
            ValueError: if a number is not finite, or the last dimension not `size`.
        """
        return _FORMULAS[self.representation][1](outputs)

    def encode(self, R: Array) -> Array:
        """The one target, among the outputs that stand for a rotation, that the table above states.

        Args:
            R: (..., 3, 3) rotation.

        Returns:
            (..., size). Decoded it is `R`, of a codec only nearly. That of a codec is a label and
            has no gradient.

        Raises:
            ValueError: if `R` is not a rotation to 1e-3.
        """
        if self.codec is None:
            return _FORMULAS[self.representation][2](R)
        with torch.no_grad():
            return self.codec.encode(R)

    @array_function(outputs="... n", R_gt="... 3 3")
    def loss(self, outputs: Array, R_gt: Array) -> Array:
        """The loss of each sample, for the caller to average, weigh or mask.

        Its gradient is finite everywhere, and zero where the distance is (for `geodesic` also at
        half turns, the farthest there is).

        Args:
            outputs: (..., size).
            R_gt: (..., 3, 3) the true rotations.

        Returns:
            (...) distances, at least 0, or their squares.

        Raises:
            ValueError: if `R_gt` is not a rotation to 1e-3, a number is not finite, or the last
                dimension of `outputs` not `size`.
        """
        if outputs.shape[-1] != self.size:
            shape = tuple(outputs.shape)
            fail("outputs", f"shape (..., {self.size}) for {self.representation!r}", f"{shape}")
        require_rotation("R_gt", R_gt)
        outputs, R_gt = decoders.full_precision(outputs), decoders.full_precision(R_gt)
        if self.loss_name == "geodesic":
            distance = relative_angle(self.decode(outputs), R_gt)
        elif self.loss_name == "chordal":
            distance = _length((self.decode(outputs) - R_gt).flatten(-2))
        else:
            target = self.encode(R_gt)
            distance = _length(outputs - target)
            if self.loss_name == "sign_free":
                distance = torch.minimum(distance, _length(outputs + target))
        return distance.square() if self.squared else distance

    def extra_repr(self) -> str:
        """What `print` shows."""
        return f"{self.representation!r}, {self.loss_name!r}, squared={self.squared}"


def _length(v: Tensor) -> Tensor:
    return torch.linalg.vector_norm(v, dim=-1)
