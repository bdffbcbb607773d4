"""Patterns: how much of a material's second colour there is at a point of the object.

A pattern is a function of a point in its own coordinates, `scale * (place @ point)`, and of the
material's seed, with values from 0 (`colour`) to 1 (`second`); the same share mixes `infrared` and
`second_infrared`. Edges are ramps and not steps, so that small images do not flicker.

Patterns that lie in a plane use x rightwards and y upwards; those that run around an axis use z and
the angle about it. Pictures (`label`, `print`, `keyboard`, `screen`) fill 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from data_tools.shapes.mesh import Material
from data_tools.textures import prints
from posecore.arrays import fail

__all__ = ["PATTERNS", "albedo", "infrared"]

Pattern = Callable[[np.ndarray, int], np.ndarray]


def albedo(
    materials: tuple[Material, ...], index: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """The colour of points on a surface.

    Args:
        materials: of the object.
        index: (P,) which of them each point is made of.
        points: (P, 3) in the object's frame, metres.
        normals: (P, 3) there; no pattern looks at them so far.

    Returns:
        (P, 3) float32 linear red, green and blue albedo, 0 to 1.

    Raises:
        ValueError: for a pattern that is not in `PATTERNS`, or an index without a material.
    """
    result = np.empty((len(points), 3), np.float32)
    for material, rows, share in _shares(materials, index, points, normals):
        first, second = (np.float32(c) for c in (material.colour, material.second))
        result[rows] = first + share[:, None] * (second - first)
    return result


def infrared(
    materials: tuple[Material, ...], index: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """The same for near infrared light: (P,) float32 albedo, 0 to 1."""
    result = np.empty(len(points), np.float32)
    for material, rows, share in _shares(materials, index, points, normals, plain_infrared=True):
        first = np.float32(material.infrared)
        second = first if material.second_infrared is None else material.second_infrared
        result[rows] = first + share * (np.float32(second) - first)
    return result


def _shares(
    materials: tuple[Material, ...],
    index: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    plain_infrared: bool = False,
) -> Iterator[tuple[Material, np.ndarray, np.ndarray]]:
    """Each material in use, the rows that it covers, and its pattern's share there."""
    index, points, normals = (np.asarray(array) for array in (index, points, normals))
    if points.ndim != 2 or points.shape[1] != 3:
        fail("points", "shape (P, 3)", points.shape)
    if normals.shape != points.shape:
        fail("normals", f"shape {points.shape} as the points", normals.shape)
    if index.shape != points.shape[:1] or index.dtype.kind not in "iu":
        fail("index", f"{len(points)} integers", f"{index.dtype} {index.shape}")
    if len(index) and not 0 <= index.min() <= index.max() < len(materials):
        fail("index", f"0 to {len(materials) - 1}", f"{index.min()} to {index.max()}")
    if not np.isfinite(points).all():
        fail("points", "finite metres", "others")
    points = points.astype(np.float32, copy=False)
    for number in np.flatnonzero(np.bincount(index, minlength=len(materials))):
        material = materials[number]
        if material.pattern not in PATTERNS:
            fail("pattern", "one of " + ", ".join(map(repr, PATTERNS)), repr(material.pattern))
        rows = np.flatnonzero(index == number)
        if material.pattern == "" or (plain_infrared and material.second_infrared is None):
            yield material, rows, np.zeros(len(rows), np.float32)
            continue
        place = np.float32(material.place).reshape(3, 4) * np.float32(material.scale)
        local = points[rows] @ place[:, :3].T + place[:, 3]
        yield material, rows, PATTERNS[material.pattern](local, material.seed)


def _ramp(values: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.clip((values - low) * np.float32(1 / (high - low)), 0, 1)


def _wave(values: np.ndarray, share: float = 0.5) -> np.ndarray:
    """A square wave of period 1 with soft edges; `share` of a period is high, about 0."""
    away = np.abs(values - np.round(values))
    return 1 - _ramp(away, share / 2 - 0.06, share / 2 + 0.06)


def _angle(p: np.ndarray) -> np.ndarray:
    """Turns about z, -1/2 to 1/2."""
    return np.arctan2(p[:, 1], p[:, 0]) * np.float32(0.5 / np.pi)


def _shifted(p: np.ndarray, seed: int) -> np.ndarray:
    """Another part of the noise for each seed."""
    return p + np.float32([0.37, 0.59, 0.83]) * np.float32(seed % 1000)


def _noise(p: np.ndarray, seed: int) -> np.ndarray:
    return prints.noise(_shifted(p, seed))


def _marble(p: np.ndarray, seed: int) -> np.ndarray:
    veins = np.abs(prints.noise(_shifted(p, seed)) - np.float32(0.5))
    return 1 - _ramp(veins, 0.02, 0.16)


def _pulp(p: np.ndarray, seed: int) -> np.ndarray:
    """Mottled cardboard, the same after half a turn about z."""
    return (_noise(p, seed) + _noise(p * np.float32([-1, -1, 1]), seed)) / 2


def _speckle(p: np.ndarray, seed: int) -> np.ndarray:
    return _ramp(prints.noise(_shifted(p, seed)), 0.62, 0.76)


def _blotches(p: np.ndarray, seed: int) -> np.ndarray:
    return _ramp(prints.noise(_shifted(p, seed)), 0.46, 0.54)


def _stripes(p: np.ndarray, seed: int) -> np.ndarray:
    return _wave(p[:, 0])


def _rings(p: np.ndarray, seed: int) -> np.ndarray:
    return _wave(p[:, 2])


def _checker(p: np.ndarray, seed: int) -> np.ndarray:
    """Squares in x and y, the same after half a turn about z."""
    waves = np.sin(2 * np.pi * p[:, 0]) * np.sin(2 * np.pi * p[:, 1])
    return _ramp(waves, -0.15, 0.15)


def _dots(p: np.ndarray, seed: int) -> np.ndarray:
    """Dots around z, twelve in a row, each row half a step further; a row for each 1 of z."""
    row = np.round(p[:, 2])
    across = 12 * _angle(p) + np.float32(0.5) * (row % 2)
    across -= np.round(across)
    return 1 - _ramp(np.hypot(across, p[:, 2] - row), 0.24, 0.36)


def _ribs(p: np.ndarray, seed: int) -> np.ndarray:
    """Grooves along z, 24 around."""
    return _wave(24 * _angle(p), 0.4)


def _petals(p: np.ndarray, seed: int) -> np.ndarray:
    """Broad stripes down a round body, eight around."""
    return _wave(8 * _angle(p))


def _wood(p: np.ndarray, seed: int) -> np.ndarray:
    """Grain along x: rings of a trunk, bent a little and cut lengthwise."""
    p = _shifted(p, seed)
    bend = prints.noise(p * np.float32([0.08, 0.3, 0.3]))
    fine = prints.noise(p * np.float32([0.1, 1.5, 1.5]))
    rings = np.float32(0.5) + np.float32(0.5) * np.sin(24 * bend + 14 * p[:, 1])
    return np.clip(np.float32(0.55) * rings + np.float32(0.45) * fine, 0, 1)


def _planks(p: np.ndarray, seed: int) -> np.ndarray:
    """Boards along x, one for each 1 of y, each of its own wood."""
    board = np.floor(p[:, 1])
    tone = np.float32(0.35) * (np.sin(board * 12.9 + seed) * np.float32(43.7) % 1)
    along = p + np.float32([1.7, 0.3, 0]) * board[:, None]
    gap = 1 - _ramp(np.abs(p[:, 1] - np.round(p[:, 1])), 0.01, 0.05)
    return np.clip(np.maximum(np.float32(0.6) * _wood(along, seed) + tone, gap), 0, 1)


def _tabby(p: np.ndarray, seed: int) -> np.ndarray:
    """Wavy bands across z, wide and narrow."""
    bend = prints.noise(_shifted(p / 16, seed))
    return _wave(p[:, 2] + 2.5 * bend, 0.38)


def _tiles(p: np.ndarray, seed: int) -> np.ndarray:
    """Square tiles between joints, one for each 1 of x and y."""
    joint = np.abs(p[:, :2] - np.round(p[:, :2])).min(1)
    return np.maximum(1 - _ramp(joint, 0.015, 0.06), np.float32(0.5) * _noise(p, seed))


def _brushed(p: np.ndarray, seed: int) -> np.ndarray:
    return _noise(p * np.float32([0.06, 1, 1]), seed)


def _cloth(p: np.ndarray, seed: int) -> np.ndarray:
    """A coarse weave over folds of light and dark."""
    weave = np.sin(2 * np.pi * 24 * p[:, 0]) * np.sin(2 * np.pi * 24 * p[:, 1])
    return np.clip(np.float32(0.7) * _noise(p, seed) + np.float32(0.15) * (1 + weave), 0, 1)


def _strands(p: np.ndarray, seed: int) -> np.ndarray:
    """Locks of hair along y."""
    return _noise(p * np.float32([1, 0.12, 1]), seed)


def _label(p: np.ndarray, seed: int) -> np.ndarray:
    return prints.look_up(prints.label(seed), _angle(p), 1 - p[:, 2])


def _print(p: np.ndarray, seed: int) -> np.ndarray:
    """The front of a label, flat."""
    return prints.look_up(
        prints.label(seed), np.clip(p[:, 0], 0.003, 1) * prints.FRONT, 1 - p[:, 1]
    )


def _keyboard(p: np.ndarray, seed: int) -> np.ndarray:
    return prints.look_up(prints.keyboard(), np.clip(p[:, 0], 0.001, 0.999), 1 - p[:, 1])


def _screen(p: np.ndarray, seed: int) -> np.ndarray:
    return prints.look_up(prints.screen(seed), np.clip(p[:, 0], 0.003, 0.997), 1 - p[:, 1])


def _eye(p: np.ndarray, seed: int) -> np.ndarray:
    """Seen along z: the iris within 1/2 of the axis, the pupil within 1/5."""
    away = np.hypot(p[:, 0], p[:, 1])
    iris = np.float32(0.75) * (1 - _ramp(away, 0.44, 0.56))
    return np.where(p[:, 2] > 0, np.maximum(iris, 1 - _ramp(away, 0.15, 0.25)), 0)


def _face(p: np.ndarray, seed: int) -> np.ndarray:
    """Brows, mouth, nostrils and, for odd seeds, stubble: x to the left, y up, z forward, metres.

    Landmarks at their places in `data_tools.shapes.heads`.
    """
    x, y = np.abs(p[:, 0]), p[:, 1]

    def spot(cx: float, cy: float, rx: float, ry: float, bow: float = 0.0) -> np.ndarray:
        a, b = (x - cx) / rx, (y - cy + bow * (x - cx) ** 2) / ry
        return np.exp(-((a * a + b * b) ** 2))

    front = _ramp(p[:, 2], -0.06, -0.04)
    share = np.maximum(
        spot(0.031, 0.0225, 0.019, 0.0048, 12), 0.75 * spot(0, -0.0625, 0.024, 0.002)
    )
    share = np.maximum(share, 0.8 * spot(0.0075, -0.0435, 0.0045, 0.0028))
    if seed % 2:
        chin = 1 - _ramp(np.hypot(x / 1.1, y + 0.095), 0.045, 0.075)
        share = np.maximum(share, 0.35 * np.maximum(chin, spot(0, -0.052, 0.026, 0.006)))
    freckles = np.float32(0.12) * prints.noise(_shifted(p * 12, seed))
    return np.clip(np.maximum(share * front, freckles), 0, 1).astype(np.float32)


PATTERNS: dict[str, Pattern] = {
    "": lambda p, seed: np.zeros(len(p), np.float32),
    "blotches": _blotches,
    "brushed": _brushed,
    "checker": _checker,
    "cloth": _cloth,
    "dots": _dots,
    "eye": _eye,
    "face": _face,
    "keyboard": _keyboard,
    "label": _label,
    "marble": _marble,
    "noise": _noise,
    "petals": _petals,
    "planks": _planks,
    "print": _print,
    "pulp": _pulp,
    "ribs": _ribs,
    "rings": _rings,
    "screen": _screen,
    "speckle": _speckle,
    "stripes": _stripes,
    "strands": _strands,
    "tabby": _tabby,
    "tiles": _tiles,
    "wood": _wood,
}
