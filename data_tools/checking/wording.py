"""What a wrong size is called, and which of two explanations of it is plausible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_tools.checking.corrections import Correction
from data_tools.checking.fits import snapped
from data_tools.checking.sample import Instance
from data_tools.units import DIAMETERS, DISTANCES

__all__ = [
    "all_lengths",
    "near_unit",
    "number",
    "plausible_owner",
    "scale_words",
    "sizes_plausible",
    "times",
    "too_large",
]

UNITS = {
    1000: ("millimetres", "metres"),
    100: ("centimetres", "metres"),
    10: ("millimetres", "centimetres"),
    25.4: ("millimetres", "inches"),
    1e6: ("micrometres", "metres"),
}
"""A ratio of two units -> the smaller and the larger one."""


def near_unit(ratio: float) -> float:
    """A ratio, or that of two units if it is near to one."""
    unit = snapped(ratio)
    return ratio if unit is None else unit


def number(size: float) -> str:
    """A size that was fitted, to three digits; the ratio of two units as it is."""
    return f"{size:.3g}" if snapped(size) is None else f"{size:.4g}"


def times(ratio: float) -> str:
    """`1000 times too large`, or too small for a ratio below 1."""
    size = near_unit(ratio if ratio > 1 else 1 / ratio)
    return f"{number(size)} times too {'large' if ratio > 1 else 'small'}"


def too_large(ratio: float) -> str:
    """The same with the units that may be behind it: `(millimetres taken for metres)`."""
    size, words = near_unit(ratio if ratio > 1 else 1 / ratio), times(ratio)
    if size in UNITS:
        small, large = UNITS[size]
        words += f" ({small} taken for {large})" if ratio > 1 else f" ({large} taken for {small})"
    return words


def scale_words(correction: Correction, owner: str | None) -> tuple[str, str, str]:
    """Key, mistake and remedy of a correction that enlarges models.

    Args:
        correction: with its `factor`.
        owner: "models" or "translations", whichever are wrong; None if one cannot tell.
    """
    factor = correction.factor
    models = f"the models are {too_large(1 / factor)}"
    poses = f"the translations are {too_large(factor)}"
    if snapped(factor) is None:
        models += ": a scaled mesh"
    if owner == "models":
        key, words, remedy = "scaled models", models, f"models times {number(factor)}"
    elif owner == "translations":
        key, words, remedy = (
            "scaled translations",
            poses,
            f"translations times {number(1 / factor)}",
        )
    else:
        key, words = "scale", f"{models}, or {poses}: without depth one cannot tell"
        remedy = f"models times {number(factor)}"
    base = correction.key.removesuffix("scale").removesuffix(" and ")
    if not base:
        return key, words, remedy
    more = correction.remedy.rpartition(", ")[0]
    return f"{base} and {key}", f"{correction.mistake}; and {words}", f"{more}, {remedy}"


def all_lengths(factor: float) -> tuple[str, str, str]:
    """Key, mistake and remedy where models and translations alike are off, and depth is right."""
    words = f"models and translations are {too_large(1 / factor)}"
    return "scaled models and translations", words, f"both times {number(near_unit(factor))}"


def plausible_owner(instances: Sequence[Instance], factor: float) -> str | None:
    """Whether models or translations are wrong by a factor, as only one would be plausible."""
    diameter, distance = _sizes(instances)
    grown = _plausible(diameter * factor, distance)
    nearer = _plausible(diameter, distance / factor)
    if grown == nearer:
        return None
    return "models" if grown else "translations"


def sizes_plausible(instances: Sequence[Instance], factor: float = 1.0) -> bool:
    """Whether models and distances, times a factor, may be those of real objects."""
    diameter, distance = _sizes(instances)
    return _plausible(diameter * factor, distance * factor)


def _sizes(instances: Sequence[Instance]) -> tuple[float, float]:
    diameter = float(np.median([i.shape.diameter for i in instances]))
    return diameter, float(np.median([np.linalg.norm(i.item.t) for i in instances]))


def _plausible(diameter: float, distance: float) -> bool:
    return DIAMETERS[0] < diameter < DIAMETERS[1] and DISTANCES[0] < distance < DISTANCES[1]
