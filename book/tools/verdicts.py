"""The verdict on a claim, by rule, from the numbers of its two sides over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from posecore.arrays import fail, require_choice, require_number

__all__ = [
    "CONTRADICTED",
    "FEWEST_SEEDS",
    "HOLDS",
    "UNDECIDED",
    "Verdict",
    "require_side",
    "verdict",
]

HOLDS, CONTRADICTED, UNDECIDED = "holds", "contradicted here", "undecided"
FEWEST_SEEDS = 3


class Verdict(NamedTuple):
    """`words`, and the mean difference in the direction of the claim with its 95 % interval."""

    words: str
    difference: float
    low: float
    high: float

    @property
    def visible(self) -> float:
        """Half the interval's width: a difference above that would have been told from 0."""
        return (self.high - self.low) / 2


def verdict(
    favoured: Sequence[float],
    other: Sequence[float],
    better: str | None = None,
    margin: float | None = None,
) -> Verdict:
    """The rule: the paired difference over seeds, and Student's 95 % interval of its mean.

    With a better side, "holds" if the whole interval lies on the claim's side of 0, "contradicted
    here" if it lies on the other, and "undecided" if it contains 0: also where it is 0 alone, as
    both sides are equal in every seed. With a margin, "holds" if the whole interval lies within
    [-margin, margin], "contradicted here" if it lies outside, else "undecided". Where all
    differences are equal the interval is one point.

    Args:
        favoured, other: one number for each seed, in the same order.
        better: "higher" or "lower"; None for a claim that both are equal.
        margin: of such a claim; the difference is then favoured less other.

    Raises:
        ValueError: if there are fewer than three seeds, the two do not pair, or not exactly one of
            `better` and `margin` is given.
    """
    require_side(better, margin)
    sides = [
        np.array([require_number(n, v) for v in values])
        for n, values in (("favoured", favoured), ("other", other))
    ]
    count = len(sides[0])
    if count < FEWEST_SEEDS:
        fail("favoured", f"at least {FEWEST_SEEDS} seeds", count)
    if len(sides[1]) != count:
        fail("other", f"{count} seeds as in favoured", len(sides[1]))
    gain = (sides[0] - sides[1]) * (-1 if better == "lower" else 1)
    mean = float(gain.mean())
    # Equal differences have a mean that is off by a rounding, and so a spread that is none.
    spread = 0.0 if np.ptp(gain) == 0 else float(gain.std(ddof=1))
    half = float(stdtrit(count - 1, 0.975)) * spread / count**0.5
    low, high = mean - half, mean + half
    if margin is None:
        holds, contradicted = low > 0, high < 0
    else:
        holds, contradicted = -margin <= low and high <= margin, low > margin or high < -margin
    words = HOLDS if holds else CONTRADICTED if contradicted else UNDECIDED
    return Verdict(words, mean, low, high)


def require_side(better: object, margin: object) -> None:
    """Refuse all but a better side or a margin: `verdict` is of one or the other."""
    if margin is None:
        require_choice("better", better, ("higher", "lower"))
    elif better is not None:
        fail("better", "None beside a margin", repr(better))
    else:
        require_number("margin", margin, above=0)
