"""Which of the known mistakes explains that models and masks do not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_tools.checking import camera_fits, depths, fits
from data_tools.checking.agreement import agreement, quick_agreement
from data_tools.checking.corrections import (
    AS_GIVEN,
    Correction,
    camera_corrections,
    mask_corrections,
    pose_corrections,
)
from data_tools.checking.report import FITS
from data_tools.checking.sample import Instance, Sample, spread_out

__all__ = ["Explanation", "clearly_better", "explain", "scores_of"]

MOST_INSTANCES = 40  # that candidates are tried on
FIRST = 10  # of them for a first choice
WITHIN = 0.1  # of the best of the first choice
GOOD = 0.97  # what fits so well is not looked into: small shifts are seen otherwise
FINALISTS = 7  # candidates that are drawn exactly
ALWAYS = ("swapped fx and fy", "half a pixel", "shifted images", "scale", "wrong image size")
"""What may repair so little that the quick look does not see it."""
LEAST_GAIN = 0.015  # of the median, if nearly all objects gain
CLEAR_GAIN = 0.1
LEAST_REPAIRED = 0.5  # what is corrected must fit at least so well


@dataclass(frozen=True, eq=False)
class Explanation:
    """A mistake that explains why things do not fit.

    Attributes:
        correction: what undoes it.
        before, after: median agreement as given, and corrected.
        others: corrections that repair as well with as little freedom.
    """

    correction: Correction
    before: float
    after: float
    others: tuple[Correction, ...] = ()


def scores_of(
    kind: str, instances: Sequence[Instance], correction: Correction = AS_GIVEN
) -> np.ndarray:
    """(N,) the agreement of each instance."""
    return np.array([agreement(kind, instance, correction) for instance in instances])


def explain(
    kind: str, sample: Sample, instances: Sequence[Instance], before: np.ndarray
) -> Explanation | None:
    """Find the mistake whose undoing repairs most, of those with as little freedom as possible.

    Args:
        kind: "masks", "depth" or "boxes": what is compared.
        sample: that the instances are of.
        instances: all that may have the same mistake.
        before: (N,) their agreement as given.

    Returns:
        None if undoing no mistake makes it clearly better.
    """
    # Of depth alone, much that is wrong looks right where an object is large and flat.
    if np.median(before) >= (FITS["depth"] if kind == "depth" else GOOD):
        return None
    chosen = spread_out(len(instances), MOST_INSTANCES)
    instances, before = [instances[i] for i in chosen], before[chosen]
    candidates = _candidates(kind, sample, instances)
    if kind == "masks":
        candidates = _finalists(instances, candidates)
    few = [instances[i] for i in spread_out(len(instances), FIRST)]
    if len(instances) > FIRST:
        first = np.array([np.median(scores_of(kind, few, one)) for one in candidates])
        candidates = [candidates[k] for k in np.flatnonzero(first >= first.max() - WITHIN)]
    repaired = []
    for candidate in candidates:
        if candidate.vary is not None and kind == "masks":
            candidate = _tuned(candidate, few)
        after = scores_of(kind, instances, candidate)
        if clearly_better(before, after):
            repaired.append((candidate, float(np.median(after))))
    if not repaired:
        return None
    error = 1 - max(after for _, after in repaired)
    good = [(c, a) for c, a in repaired if 1 - a <= max(1.25 * error, error + 0.02)]
    best, after = min(good, key=lambda one: (one[0].cost, -one[1]))
    others = {
        c.mistake: c
        for c, a in good
        if c.key != best.key and c.cost <= best.cost and a >= after - 0.01
    }
    return Explanation(best, float(np.median(before)), after, tuple(others.values()))


def _candidates(kind: str, sample: Sample, instances: Sequence[Instance]) -> list[Correction]:
    """All corrections, those with sizes fitted to the instances."""
    poses, cameras = pose_corrections(sample), camera_corrections()
    if kind != "masks":  # nothing can be fitted: units by steps of ten, sizes by fractions
        few = [p for p in poses if p.key != "turned model"]
        steps = [10.0**k for k in range(-6, 7) if k]
        owners = (None,) if kind == "boxes" else ("models", "translations")
        scaled = [
            fits.rescaled(base, step, owner)
            for base in (AS_GIVEN, *few[:3])
            for step in steps
            for owner in owners
        ]
        if kind == "boxes":
            return [*poses, *cameras, *camera_fits.usual_sizes(), *scaled]
        state = depths.depth_state(instances, AS_GIVEN.place)
        unit = None if state is None else depths.unit_correction(state)
        return [*few, cameras[0], *camera_fits.usual_sizes(), *scaled, *([unit] if unit else [])]
    bases = [p for p in poses if p.key != "turned model"]
    scaled = [one for base in (AS_GIVEN, *bases) for one in fits.scale_fits(instances, base)]
    fitted = [
        *camera_fits.usual_sizes(),
        *camera_fits.camera_fits(instances),
        *fits.origin_fit(instances),
    ]
    return [*poses, *cameras, *mask_corrections(sample), *scaled, *fitted]


def _finalists(instances: Sequence[Instance], candidates: list[Correction]) -> list[Correction]:
    """The candidates that look best at a quick look, and those that it may not do justice."""
    quick = [np.mean([quick_agreement(i, c) for i in instances]) for c in candidates]
    order = sorted(range(len(candidates)), key=lambda k: -quick[k])
    chosen = order[:FINALISTS]
    chosen += [k for k in order[FINALISTS:] if candidates[k].key in ALWAYS]
    return [candidates[k] for k in chosen]


def _tuned(correction: Correction, instances: Sequence[Instance]) -> Correction:
    """The correction with the size at which exact silhouettes fit best: fitted were their hulls."""
    factor = 1.0
    for step in (0.01, 0.0025):
        tried = factor * (1 + step * np.arange(-4, 5))
        scores = [scores_of("masks", instances, correction.vary(f)).mean() for f in tried]
        factor = float(tried[int(np.argmax(scores))])
    return correction.vary(factor)


def clearly_better(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether agreement is better: by much, or by a little for nearly all of many objects."""
    old, new = float(np.median(before)), float(np.median(after))
    better, many = float((after > before).mean()), len(before) >= 8
    left = (1 - new) / max(1 - old, 1e-9)  # of what did not fit
    if new < LEAST_REPAIRED:
        return False
    if new - old >= CLEAR_GAIN:
        return (left <= 0.6 and better >= 0.7) or (left <= 0.75 and better >= 0.8 and many)
    return new - old >= LEAST_GAIN and left <= 0.6 and better >= 0.85 and many
