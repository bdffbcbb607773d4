"""The learnable rotation representation of CIPE: an autoencoder of rotations.

    R (9 numbers) -> sines, cosines -> 128 -> 128 -> LeakyReLU -> R' (9 numbers) -> Procrustes(R')

Trained until Procrustes(R') is nearly R (the paper's Eq. 3), it is frozen, and R' = Encoder_rot(R)
is the target of a network that says a rotation (Eq. 10).

Two things that the paper leaves open:

- Any R times a symmetric positive definite matrix satisfies Eq. 3, so the size of R', and with it
  that of the loss of Eq. 10, is whatever training came to. `RotationCodec.spectrum` measures it.
- The frequencies of the encoding. Octaves of pi, as for neural radiance fields, give -1 and 1 the
  same code, so the identity and three half turns would be one. Here they are 1, 2, 4, ... radians.

Source: Ren et al., "A Unified End-to-end Network for Category-level and Instance-level Object Pose
Estimation from RGB Images" (CIPE), Section III-C and Figure 2.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

from posecore import weights
from posecore.arrays import (
    Array,
    array_function,
    fail,
    require_choice,
    require_finite,
    require_integer,
    require_number,
)
from posecore.files import write_bytes
from posecore.rotations import random_rotations, require_rotation, special_procrustes
from posecore.rotations.so3 import relative_angle

__all__ = ["RotationCodec", "load_codec", "save_codec", "train_codec"]


class RotationCodec(nn.Module):
    """`Encoder_rot` and Procrustes after it.

    Args:
        octaves: how many frequencies, 1 to 10. Each turns an entry of R into a sine and a cosine.
            More than a few make the code rough, and so a harder target: ten change it several times
            as fast as `R` itself.
        width: of both layers, 128 in the paper.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(self, octaves: int = 4, width: int = 128) -> None:
        super().__init__()
        self.octaves = require_integer("octaves", octaves, 1, 10)
        self.width = require_integer("width", width, 1)
        self.project = nn.Linear(9 * 2 * self.octaves, self.width)
        self.mlp = nn.Sequential(
            nn.Linear(self.width, self.width), nn.LeakyReLU(), nn.Linear(self.width, 9)
        )

    @array_function(R="... 3 3")
    def encode(self, R: Array) -> Array:
        """`Encoder_rot(R)`: a matrix whose nearest rotation is almost `R`.

        Args:
            R: (..., 3, 3) rotation.

        Returns:
            (..., 9) the matrix R', row by row.

        Raises:
            ValueError: if `R` is not a rotation to 1e-3.
        """
        require_rotation("R", R)
        numbers = R.flatten(-2).to(self.project.weight.dtype)
        frequencies = 2.0 ** torch.arange(self.octaves).to(numbers)
        phases = numbers[..., None] * frequencies  # (..., 9, octaves)
        waves = torch.cat([phases.sin(), phases.cos()], -1).flatten(-2)  # (..., 18 octaves)
        return self.mlp(self.project(waves)).to(R.dtype)

    @array_function(R="... 3 3")
    def forward(self, R: Array) -> Array:
        """Encode and decode.

        Args:
            R: (..., 3, 3) rotation.

        Returns:
            (..., 3, 3) rotation, near to `R` once the codec is trained.
        """
        return special_procrustes(self._code(R))

    @array_function(R="... 3 3")
    def spectrum(self, R: Array) -> Array:
        """The size and shape of the code: the singular values of R'.

        Their mean is its scale, tr(Procrustes(R')^T R') / 3. An error in a network's outputs turns
        the rotation by that error over the sum of two of them: the larger, the safer.

        Args:
            R: (..., 3, 3) rotations, for example of `random_rotations`.

        Returns:
            (..., 3) from large to small; the last with the sign of det R'.
        """
        code = self._code(R)
        values = torch.linalg.svdvals(code)
        sign = torch.linalg.det(code).sign()[..., None]
        return torch.cat([values[..., :2], sign * values[..., 2:]], -1)

    def _code(self, R: Tensor) -> Tensor:
        """(..., 3, 3)."""
        code = self.encode(R)
        require_finite("codec", code, "weights that give finite codes")
        return code.unflatten(-1, (3, 3))


def train_codec(
    *,
    seed: int,
    steps: int = 3000,
    batch: int = 256,
    learning_rate: float = 5e-3,
    loss: str = "chordal",
    octaves: int = 4,
    width: int = 128,
    device: torch.device | str = "cpu",
    report: Callable[[int, float], None] | None = None,
) -> RotationCodec:
    """Train a codec on rotations drawn uniformly, and freeze it.

    Adam, its rate falling to zero along half a cosine.

    Args:
        seed: of weights and rotations. The same seed gives the same codec on the same machine.
        steps: how many, each with new rotations.
        batch: how many rotations in a step.
        learning_rate: of the first step.
        loss: between R and the decoded rotation, which the paper leaves open: `chordal`, the mean
            squared Frobenius norm of the difference, or `geodesic`, the mean angle.
        octaves, width: of the codec.
        device: to train on; the rotations are the same on all.
        report: called after each step with its number, from 1, and its loss.

    Returns:
        The codec, frozen.

    Raises:
        ValueError: if a number or a name is not allowed.
    """
    require_integer("seed", seed, 0, 2**63 - 1)
    require_integer("steps", steps, 1)
    require_integer("batch", batch, 1)
    require_number("learning_rate", learning_rate, above=0)
    require_choice("loss", loss, ("chordal", "geodesic"))
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)
        codec = RotationCodec(octaves, width).to(device)
        generator = torch.Generator()
        generator.set_state(torch.get_rng_state())  # the rotations go on where the weights ended
    optimiser = torch.optim.Adam(codec.parameters(), learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(1, steps + 1):
        R = random_rotations(batch, generator=generator, dtype=torch.float32).to(device)
        decoded = codec(R)
        if loss == "geodesic":
            error = relative_angle(decoded, R).mean()
        else:
            error = (decoded - R).square().sum((-2, -1)).mean()
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        schedule.step()
        if report is not None:
            report(step, error.item())
    return codec.requires_grad_(False)


def save_codec(codec: RotationCodec, path: str | Path) -> None:
    """Write a codec's weights as safetensors with their digest, whole or not at all.

    Raises:
        OSError: if the file cannot be written.
    """
    write_bytes(Path(path), weights.pack(codec.state_dict()))


def load_codec(path: str | Path) -> RotationCodec:
    """Read what `save_codec` wrote; the sizes follow from the weights.

    Returns:
        The codec, frozen.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is damaged or holds something else than was written.
    """
    try:
        kept = weights.unpack(Path(path).read_bytes())
        width, waves = kept["project.weight"].shape
        codec = RotationCodec(waves // 18, width)
        weights.fill(codec, kept)
    except (KeyError, ValueError, RuntimeError) as error:
        fail("path", "a file that save_codec wrote", f"{path} ({error})")
    return codec.requires_grad_(False)
