"""Random augmentation: how images are varied each time they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from posecore.arrays import require_integer, require_number

__all__ = ["Augmentation", "Draws"]


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """How far images are varied. All defaults are meant to be used; 0 switches a part off.

    Geometry turns the camera about its principal ray and moves the box that is cut out; pose and
    camera matrix follow exactly, and each image is resampled once. There is no mirroring: the
    mirror image of an object is another object, which has no pose.

    Args:
        turn: radians; the camera is turned by up to so much, either way.
        shift: of the box, each way, up to so much of its sides.
        zoom: factor on the object's size in the result, up to so much or its inverse.
        background: share of images in which all that is no object is replaced by what another
            image of the batch has there, or by a random pattern. If above 0, what lies outside
            the image is always filled so; else it is black and without depth.
        occluder: share of objects that something is put in front of: a random shape, or what
            another image of the batch has cut out.
        keep: what an occluder leaves of what is seen of an object, at the least; one that would
            cover more is left out. Of every object in the image, whichever it was meant for.
        light: strength of changes to brightness, contrast and gamma, as factors exp(+-light).
        colour: strength of changes to saturation and to the channels' gains, exp(+-colour).
        blur: standard deviation of a Gaussian, up to so many pixels.
        noise: standard deviation, up to so much of full scale.
        depth_noise: standard deviation, up to so many metres at 1 m; it grows with the square.
        holes: share of images in which depth is missing in random spots.

    Raises:
        ValueError: naming the argument that is out of its range.
    """

    turn: float = np.pi / 6
    shift: float = 0.1
    zoom: float = 1.25
    background: float = 0.5
    occluder: float = 0.5
    keep: float = 0.4
    light: float = 0.25
    colour: float = 0.15
    blur: float = 1.2
    noise: float = 0.03
    depth_noise: float = 0.003
    holes: float = 0.3

    def __post_init__(self) -> None:
        bounds = {"turn": np.pi, "shift": 1, "zoom": 10, "light": 3, "colour": 3, "blur": 100}
        for field in fields(self):
            low, high = float(field.name == "zoom"), bounds.get(field.name, 1)
            number = require_number(field.name, getattr(self, field.name), low, high)
            object.__setattr__(self, field.name, number)

    @classmethod
    def none(cls) -> Augmentation:
        """Everything switched off."""
        return cls(**{field.name: float(field.name == "zoom") for field in fields(cls)})

    def draw(self, count: int, seed: int) -> Draws:
        """The random choices for so many images.

        They are drawn whatever is switched off, so that what is left stays as it was.

        Raises:
            ValueError: if `count` or `seed` is no integer of at least 0.
        """
        require_integer("count", count, 0)
        require_integer("seed", seed, 0)
        rng = np.random.default_rng(seed)
        signed = rng.uniform(-1, 1, (count, 14))
        share = rng.random((count, 3))
        return Draws(
            turn=self.turn * signed[:, 0],
            shift=self.shift * signed[:, 1:3],
            zoom=self.zoom ** signed[:, 3],
            background=share[:, 0] < self.background,
            occluder=share[:, 1] < self.occluder,
            brightness=np.exp(self.light * signed[:, 4]),
            contrast=np.exp(self.light * signed[:, 5]),
            gamma=np.exp(self.light * signed[:, 6]),
            saturation=np.exp(self.colour * signed[:, 7]),
            gains=np.exp(self.colour * signed[:, 8:11]),
            blur=self.blur * np.abs(signed[:, 11]),
            noise=self.noise * np.abs(signed[:, 12]),
            depth_noise=self.depth_noise * np.abs(signed[:, 13]),
            holes=share[:, 2] < self.holes,
            partner=_partners(rng, count),
            seed=rng.integers(2**63, size=(count, 2)),
        )


@dataclass(frozen=True)
class Draws:
    """Random choices for B images, (B,) each if not said otherwise.

    Attributes:
        turn: radians.
        shift: (B, 2) of the box's sides.
        zoom: factor.
        background, occluder, holes: whether.
        brightness, contrast, gamma, saturation: factors, and `gains` (B, 3) of the channels.
        blur: pixels.
        noise, depth_noise: standard deviations.
        partner: another image of the batch, for backgrounds and occluders.
        seed: (B, 2) of what is drawn for each image: occluder and background, sensor.
    """

    turn: np.ndarray
    shift: np.ndarray
    zoom: np.ndarray
    background: np.ndarray
    occluder: np.ndarray
    brightness: np.ndarray
    contrast: np.ndarray
    gamma: np.ndarray
    saturation: np.ndarray
    gains: np.ndarray
    blur: np.ndarray
    noise: np.ndarray
    depth_noise: np.ndarray
    holes: np.ndarray
    partner: np.ndarray
    seed: np.ndarray


def _partners(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count,) for each another one, all different: the next one round a random table."""
    table = rng.permutation(count)
    partner = np.empty(count, np.int64)
    partner[table] = np.roll(table, 1)
    return partner
