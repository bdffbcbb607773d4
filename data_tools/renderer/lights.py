"""Lamps and the light that comes from all around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posecore.arrays import fail, require_number, to_numbers

__all__ = ["Ambient", "Light"]


@dataclass(frozen=True, eq=False)
class Light:
    """A lamp. Its light falls with the square of the distance.

    Attributes:
        position: (3,) metres in the camera's frame.
        power: one number or (3,) red, green, blue: how bright it makes a white surface that faces
            it at a distance of 1 m.
        radius: metres; a larger lamp throws softer shadows.
        shadows: whether it throws any.
        beam: how the light falls off to the sides of the camera's axis, as the cosine to this
            power; 0 shines to all sides, LEDs have 1 to 10.

    Raises:
        ValueError: naming the field that does not fit this description.
    """

    position: np.ndarray
    power: float | np.ndarray = 1.0
    radius: float = 0.02
    shadows: bool = True
    beam: float = 0.0

    def __post_init__(self) -> None:
        position, power = to_numbers("position", self.position), to_numbers("power", self.power)
        if position.shape != (3,) or not np.isfinite(position).all():
            fail("position", "three finite metres", self.position)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "power", _intensity("power", power))
        object.__setattr__(self, "radius", require_number("radius", self.radius, 0))
        object.__setattr__(self, "beam", require_number("beam", self.beam, 0))
        if not isinstance(self.shadows, bool | np.bool_):
            fail("shadows", "True or False", repr(self.shadows))


@dataclass(frozen=True, eq=False)
class Ambient:
    """Light from all around: one colour from above, another from below, and between between.

    Attributes:
        above, below: one number or (3,) red, green, blue; how bright a white surface is that faces
            up or down.
        up: (3,) which way up is in the camera's frame.

    Raises:
        ValueError: naming the field that does not fit this description.
    """

    above: float | np.ndarray = (0.24, 0.25, 0.28)
    below: float | np.ndarray = (0.11, 0.10, 0.09)
    up: np.ndarray = (0.0, -1.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("above", "below"):
            values = _intensity(name, to_numbers(name, getattr(self, name)))
            object.__setattr__(self, name, values)
        up = to_numbers("up", self.up)
        if up.shape != (3,) or not np.isfinite(up).all() or not up.any():
            fail("up", "a direction", self.up)
        object.__setattr__(self, "up", up / np.linalg.norm(up))


def _intensity(name: str, values: np.ndarray) -> np.ndarray:
    if values.shape not in ((), (3,)) or not np.isfinite(values).all() or (values < 0).any():
        fail(name, "one number of at least 0, or three", values.tolist())
    return np.broadcast_to(values, 3)
