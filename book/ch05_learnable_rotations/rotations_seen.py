"""What chapter 5 measures on pictures: how a teapot is turned, from its image and from its points.

Networks answer in the frame of the ray through the middle of what is seen: a camera that was turned
to look straight at the object. In the camera's own frame the same picture of a teapot means another
rotation wherever in the image it is cut out, and a crop does not show where that was. `facing` goes
from one frame to the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn

import data_tools
from book.ch05_learnable_rotations import rotation_tables as tables
from book.tools.keys import Key
from data_tools import batches
from posecore.arrays import Array, array_function
from posecore.nets.rotation_heads import RotationHead
from posecore.rotations import axis_angle_to_matrix
from posecore.scale import choose
from posecore.training import History, fit

SideBySide = tables.SideBySide

__all__ = [
    "FOUR",
    "PIXELS",
    "TEAPOT",
    "PointNet",
    "Seen",
    "clouds",
    "conv_net",
    "facing",
    "from_images",
    "from_points",
    "images",
    "train_on_images",
    "train_on_points",
    "varied",
]

TEAPOT = 5
"""The object of `tabletop`. Spout, handle and lid leave it no symmetry."""
PIXELS = 64
"""Width and height of a crop."""
POINTS = 128
"""That a network is given of a cloud."""
UNIT = 0.1
"""Metres that are 1 for a network."""
TURNED = batches.Augmentation(turn=np.pi)
FOUR = ("quaternion, chordal", "6d, chordal", "procrustes, chordal", "learnable, output")
"""Table III's lower half: a loss on R where the paper has one, and its own representation."""


@dataclass(frozen=True)
class Seen:
    """N looks at the teapot.

    Attributes:
        inputs: (N, 3, h, w) uint8 images, or (N, P, 3) points in units of 0.1 m about their mean.
        R: (N, 3, 3) float32 the teapot's rotation, in the frame of the ray.
    """

    inputs: Tensor
    R: Tensor


@array_function(rays="... 3")
def facing(rays: Array) -> Array:
    """The smallest turn of a camera after which it looks along a ray.

    Args:
        rays: (..., 3) of any length, in front of the camera.

    Returns:
        (..., 3, 3) rotation that takes the ray to the z axis.
    """
    x, y, z = nn.functional.normalize(rays, dim=-1).unbind(-1)
    axis = torch.stack([y, -x, torch.zeros_like(z)], -1)  # ray cross z: its length is the sine
    sine = torch.linalg.vector_norm(axis, dim=-1)
    angle = torch.atan2(sine, z)
    return axis_angle_to_matrix(axis * (angle / sine.clamp_min(1e-12))[..., None])


# Images -------------------------------------------------------------------------------------------


@lru_cache(maxsize=4)
def images(split: str, looks: int, *, augment: batches.Augmentation = TURNED) -> Seen:
    """Crops of the teapot, each varied anew.

    Args:
        split: of `tabletop`.
        looks: how often each teapot is looked at.
        augment: what is varied. Turning the camera covers all rotations about the ray.
    """
    data, rows = _teapots(split)
    generator = torch.Generator().manual_seed(0)
    crops, rotations = [], []
    for part in rows.repeat(looks).split(64):
        batch = data.crops(part, PIXELS, augment=augment, generator=generator)
        middle = torch.tensor([(PIXELS - 1) / 2, (PIXELS - 1) / 2, 1.0])
        rays = torch.linalg.solve(batch["K"], middle.expand(len(part), 3))
        crops.append((255 * batch["rgb"]).round().byte())
        rotations.append(facing(rays) @ batch["R"])
    return Seen(torch.cat(crops), torch.cat(rotations))


def conv_net(size: int) -> nn.Sequential:
    """(B, 3, 64, 64) -> (B, size)."""
    layers: list[nn.Module] = []
    for before, after in ((3, 16), (16, 32), (32, 64), (64, 128)):
        layers += [nn.Conv2d(before, after, 3 if layers else 5, 2, padding=1 if layers else 2)]
        layers += [nn.BatchNorm2d(after), nn.ReLU()]
    return nn.Sequential(
        *layers,  # (B, 128, 4, 4)
        nn.Flatten(),
        nn.Linear(128 * (PIXELS // 16) ** 2, 256),
        nn.BatchNorm1d(256),  # else some networks died, and said 0 for ever
        nn.ReLU(),
        nn.Linear(256, size),
    )


def train_on_images(
    seen: Seen, heads: dict[str, RotationHead], seed: int, steps: int, show: bool | None = False
) -> tuple[SideBySide, History]:
    """Train a small convolutional network for each head, 64 images a step."""

    def draw(generator: torch.Generator) -> tuple[Tensor, Tensor]:
        rows = torch.randint(len(seen.R), (64,), generator=generator)
        return seen.inputs[rows].float() / 255, seen.R[rows]

    return _trained(heads, conv_net, draw, seed, steps, show, "auto")


# Points -------------------------------------------------------------------------------------------


@lru_cache(maxsize=4)
def clouds(split: str) -> Seen:
    """What depth shows of the teapot: 512 points of each, some of them several times."""
    data, rows = _teapots(split)
    generator = torch.Generator().manual_seed(0)
    points, rotations = [], []
    for part in rows.split(64):
        batch = data.crops(part, PIXELS)
        y, x = torch.meshgrid(*[torch.arange(PIXELS, dtype=torch.float32)] * 2, indexing="ij")
        rays = torch.stack([x, y, torch.ones_like(x)], -1) @ batch["K"].inverse().mT[:, None]
        for ray, depth, mask, R in zip(
            rays, batch["depth"], batch["mask"], batch["R"], strict=True
        ):
            seen = mask & (depth > 0)
            if seen.sum() < 16:
                continue
            cloud = ray[seen] * depth[seen][:, None]
            cloud = cloud[torch.randint(len(cloud), (512,), generator=generator)]
            middle = cloud.median(0).values
            turn = facing(middle)
            points.append((cloud - cloud.mean(0)) @ turn.mT / UNIT)
            rotations.append(turn @ R)
    return Seen(torch.stack(points), torch.stack(rotations))


class PointNet(nn.Module):
    """(B, P, 3) -> (B, size): each point by itself, then the largest of all, channel by channel.

    Sines and cosines go in beside the coordinates, as into the codec: without them the network
    learnt next to nothing in the same time.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.each = nn.Sequential(
            nn.Linear(21, 128), nn.BatchNorm1d(128), nn.ReLU(), nn.Linear(128, 256)
        )
        self.all = nn.Sequential(
            nn.BatchNorm1d(256), nn.ReLU(),
            nn.Linear(256, 256), nn.BatchNorm1d(256), nn.ReLU(),
            nn.Linear(256, size),
        )  # fmt: skip

    def forward(self, points: Tensor) -> Tensor:
        """What the network says of each cloud."""
        phases = torch.cat([1.5 * points, 3 * points, 6 * points], -1)
        numbers = torch.cat([points, phases.sin(), phases.cos()], -1)  # (B, P, 21)
        each = self.each(numbers.flatten(0, 1)).unflatten(0, points.shape[:2])  # (B, P, 256)
        return self.all(each.amax(1))


def varied(seen: Seen, rows: Tensor, generator: torch.Generator, hide: float = 0.4) -> Seen:
    """Clouds turned about the ray, of which a side is hidden and some points are taken.

    Args:
        seen: clouds.
        rows: (B,) which ones.
        generator: of what is random.
        hide: of every cloud up to this part, on one side; 0 for nothing.
    """
    turns = torch.zeros(len(rows), 3)
    turns[:, 2] = 2 * np.pi * torch.rand(len(rows), generator=generator)
    Rz = axis_angle_to_matrix(turns)
    points = seen.inputs[rows] @ Rz.mT
    hidden = hide * torch.rand(len(rows), 1, generator=generator)
    # They are turned at random already, so the side may be the same for all.
    order = points[..., 0].argsort(1)  # what has the largest x is hidden
    chosen = torch.rand(len(rows), POINTS, generator=generator) * (1 - hidden)
    chosen = order.gather(1, (chosen * points.shape[1]).long())
    points = points.gather(1, chosen[..., None].expand(-1, -1, 3))
    return Seen(points - points.mean(1, keepdim=True), Rz @ seen.R[rows])


def train_on_points(
    seen: Seen, heads: dict[str, RotationHead], seed: int, steps: int, show: bool | None = False
) -> tuple[SideBySide, History]:
    """Train a small PointNet for each head, 64 clouds a step."""

    def draw(generator: torch.Generator) -> tuple[Tensor, Tensor]:
        batch = varied(seen, torch.randint(len(seen.R), (64,), generator=generator), generator)
        return batch.inputs, batch.R

    # Twice as fast, and three digits are enough where errors are of many degrees.
    return _trained(heads, PointNet, draw, seed, steps, show, "bfloat16")


# Measured -----------------------------------------------------------------------------------------


def from_images(seed: int) -> dict[Key, float]:
    """Degrees by which networks err on crops; representation and loss are crossed.

    Tests look four times at each teapot, with the camera turned about its principal ray.
    """
    seen = images("train", choose(tiny=1, book=24, paper=40))
    heads = tables.crossed(tables.codec_of(seed))
    networks, _ = train_on_images(seen, heads, seed, choose(tiny=2, book=2000, paper=30_000))
    only_turned = replace(batches.Augmentation.none(), turn=np.pi)
    numbers = {}
    for split in ("easy", "occluded"):
        test = images(split, 4, augment=only_turned)
        numbers |= _summary(split, tables.degrees_off(networks, test.inputs.float() / 255, test.R))
    return numbers


def from_points(seed: int) -> dict[Key, float]:
    """Degrees by which networks err on clouds: the four representations of Table III, and R itself
    as the target of a loss in Euclidean space."""
    all_heads = tables.crossed(tables.codec_of(seed))
    heads = {name: all_heads[name] for name in (*FOUR, "procrustes, output")}
    steps = choose(tiny=2, book=2500, paper=30_000)
    networks, _ = train_on_points(clouds("train"), heads, seed, steps)
    numbers = {}
    for split in ("easy", "occluded"):
        test = clouds(split)
        rows = torch.arange(len(test.R)).repeat(4)
        test = varied(test, rows, torch.Generator().manual_seed(1), hide=0)
        numbers |= _summary(split, tables.degrees_off(networks, test.inputs, test.R))
    return numbers


def _trained(
    heads: dict[str, RotationHead],
    network: Callable[[int], nn.Module],
    draw: Callable[[torch.Generator], tuple[Tensor, Tensor]],
    seed: int,
    steps: int,
    show: bool | None,
    precision: str,
) -> tuple[SideBySide, History]:
    networks = SideBySide(heads, network, seed)
    history = fit(
        networks,
        draw,
        lambda networks, batch: networks.losses(*batch),
        steps=steps,
        lr=2e-3,
        seed=seed,
        device="cpu",
        precision=precision,
        show=show,
    )
    return networks, history


def _summary(split: str, degrees: dict[str, np.ndarray]) -> dict[Key, float]:
    """Mean, median, and the share in percent that is right to 10 and to 20 degrees."""
    numbers = {}
    for name, off in degrees.items():
        numbers[Key(name, split, "rotation")] = off.mean()
        numbers[Key(name, split, "rotation median")] = np.median(off)
        for limit in (10, 20):
            numbers[Key(name, split, f"rotation < {limit} deg")] = 100 * (off < limit).mean()
    return {key: float(value) for key, value in numbers.items()}


@lru_cache(maxsize=4)
def _teapots(split: str) -> tuple[batches.Stack, Tensor]:
    data = batches.load(data_tools.open("tabletop", split=split))
    return data, data.rows(object_id=TEAPOT, visible=0.3)
