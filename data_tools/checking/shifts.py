"""Shifts of less than a pixel, from the mean over many silhouettes, with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_tools.checking.camera_fits import half_words
from data_tools.checking.corrections import AS_GIVEN, Place, camera_corrections
from data_tools.checking.drawing import Placement, draw, hull_of
from data_tools.checking.report import Finding, Report
from data_tools.checking.sample import Instance, spread_out

__all__ = ["MeanShift", "check", "mean_shift", "swap_share"]

PROBE = 1.0  # pixels by which the camera is moved to see how a silhouette answers
LEAST_SHIFT = 0.25  # pixels
SURE = 4.0  # standard errors
MOST_OBJECTS = 80  # whose shift is measured
LEAST_SPREAD = 0.1  # pixels: borders are counted in whole ones
LEAST_ANSWER = 0.4  # of a shift of one pixel: where less is seen of it, it is hidden


@dataclass(frozen=True)
class MeanShift:
    """Where masks lie against the drawn silhouettes.

    Attributes:
        shift: (2,) x and y in pixels, the mean; positive where the masks lie right of and below
            the silhouettes.
        error: (2,) its standard error.
        count: objects that it is the mean of.
        each: (N, 2) of each of them.
        numbers: (N,) which instances, by their `number`.
    """

    shift: np.ndarray
    error: np.ndarray
    count: int
    each: np.ndarray
    numbers: np.ndarray


def check(report: Report) -> None:
    """The mean shift of all silhouettes; and whether fx and fy could have been swapped."""
    # What is far off hides what is a little, unless it is of some objects only.
    allowed = {"half a pixel", "shifted images", "unreadable views", "single images"}
    if {f.key for f in report.findings if f.objects is None} - allowed:
        return
    fitting = [i for i in report.sample.instances if report.fixed[i.number] >= report.least]
    fitting = [fitting[i] for i in spread_out(len(fitting), MOST_OBJECTS)]
    shifted = next(
        (f for f in report.findings if f.key in ("half a pixel", "shifted images")), None
    )
    found = mean_shift(fitting, lambda i: report.corrections[i.number].place(i))
    if shifted is not None and shifted.key == "half a pixel":
        found = mean_shift(fitting, AS_GIVEN.place)  # it is not so far that this could not be told
    if found is None:
        report.notes.append("too few objects to tell a shift of half a pixel")
        return
    (x, y), (dx, dy) = found.shift, found.error
    words = f"({x:+.2f} ± {dx:.2f}, {y:+.2f} ± {dy:.2f}) pixels, the mean of {found.count} objects"
    if shifted is not None:
        if shifted.key == "half a pixel":
            more = (*shifted.evidence, f"masks lie {words}, from the drawn models")
            report.findings[report.findings.index(shifted)] = replace(shifted, evidence=more)
        else:
            report.facts.append(f"shift: {words}, is left once corrected")
        return
    report.facts.append(f"shift: masks lie {words}, from the drawn models")
    seen = np.abs(found.shift) > np.maximum(LEAST_SHIFT, SURE * found.error)
    if seen.any():
        half = (np.abs(np.abs(found.shift) - 0.5) < 0.2).all()
        key = "half a pixel" if half else "shifted images"
        said = half_words(found.shift)
        if not half:
            said = (
                f"the images are shifted by ({x:+.2f}, {y:+.2f}) pixels against the camera matrix"
            )
        report.findings.append(Finding(key, said, (f"masks lie {words}, from the drawn models",)))
    elif found.error.max() > LEAST_SHIFT / 2:
        report.notes.append(
            f"a shift of half a pixel cannot be told from {found.count} objects: look at more "
            "with --count"
        )
    _check_swap(report, found, fitting)


def mean_shift(instances: Sequence[Instance], place: Place) -> MeanShift | None:
    """The mean shift of masks against silhouettes, to a fraction of a pixel.

    The first moment of mask minus silhouette tells a shift in units of how the moment answers to a
    shift of the camera by one pixel, which is measured by drawing once more to each side: so
    borders behind which an object is hidden count for as much as they show. Outliers beyond three
    robust standard deviations are left out.

    Args:
        instances: with masks.
        place: where each is drawn.

    Returns:
        None for fewer than three that can be used.
    """
    each, numbers = [], []
    for instance in instances:
        placed = place(instance)
        if instance.mask is None or placed is None:
            continue
        found = _shift(instance, placed)
        if found is not None:
            each.append(found)
            numbers.append(instance.number)
    if len(each) < 3:
        return None
    shifts, kept = np.array(each), np.ones(len(each), bool)
    middle = np.median(shifts, 0)
    spread = 1.4826 * np.median(np.abs(shifts - middle), 0) + LEAST_SPREAD
    kept = (np.abs(shifts - middle) <= 3 * spread).all(1)
    if kept.sum() < 3:
        return None
    shifts = shifts[kept]
    error = shifts.std(0, ddof=1) / np.sqrt(len(shifts))
    return MeanShift(shifts.mean(0), error, len(shifts), shifts, np.array(numbers)[kept])


def swap_share(shifts: MeanShift, expected: dict[int, np.ndarray]) -> tuple[float, float]:
    """How much of an expected displacement the silhouettes show, beside a common shift.

    Least squares of the shifts on the displacements that a correction would cause.

    Args:
        shifts: as measured.
        expected: (2,) pixels for each instance, by its `number`.

    Returns:
        The share, 0 for none and 1 for all of it, and its standard error; infinite where nothing
        is expected.
    """
    rows = np.array([expected[number] for number in shifts.numbers])
    varied = rows - rows.mean(0)
    power = float((varied**2).sum())
    if power < 1e-9:
        return 0.0, np.inf
    share = float((varied * (shifts.each - shifts.each.mean(0))).sum() / power)
    left = shifts.each - shifts.each.mean(0) - share * varied
    noise = float((left**2).sum()) / max(left.size - 3, 1)
    return share, float(np.sqrt(noise / power))


def _shift(instance: Instance, place: Placement) -> np.ndarray | None:
    """Of one object, (2,) pixels; None where too much of its border is hidden."""
    drawn = _known(draw(instance.shape, place, instance.size)[0], instance)
    area = np.count_nonzero(drawn)
    if not area:
        return None
    given = _moment(_known(instance.mask, instance), drawn)
    found = np.zeros(2)
    for axis in range(2):
        answers = []
        for sign in (1, -1):
            K = place.K.copy()
            K[axis, 2] += sign * PROBE
            moved = Placement(K, place.R, place.t, place.scale)
            seen = _known(draw(instance.shape, moved, instance.size)[0], instance)
            answers.append(_moment(seen, drawn)[axis])
        answer = (answers[0] - answers[1]) / (2 * PROBE)
        if answer < LEAST_ANSWER * area:
            return None
        found[axis] = given[axis] / answer
    return found


def _known(mask: np.ndarray, instance: Instance) -> np.ndarray:
    return mask if instance.others is None else mask & ~instance.others


def _moment(mask: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """(2,) the first moments of `mask` minus `drawn` about the centre of `drawn`."""
    y, x = np.nonzero(drawn)
    centre = np.array([x.mean(), y.mean()])
    y, x = np.nonzero(mask & ~drawn)
    more = np.array([(x - centre[0]).sum(), (y - centre[1]).sum()])
    y, x = np.nonzero(drawn & ~mask)
    less = np.array([(x - centre[0]).sum(), (y - centre[1]).sum()])
    return more - less


def _check_swap(report: Report, found: MeanShift, instances: Sequence[Instance]) -> None:
    """Say where it cannot be seen whether fx and fy are swapped."""
    (swap,) = (c for c in camera_corrections() if c.key == "swapped fx and fy")
    if all(i.K[0, 0] == i.K[1, 1] for i in instances):
        return
    expected = {}
    for instance in instances:
        hulls = [hull_of(instance.shape, p) for p in (instance.place, swap.place(instance))]
        if all(hull is not None for hull in hulls):
            expected[instance.number] = hulls[1].mean(0) - hulls[0].mean(0)
    if any(number not in expected for number in found.numbers):
        return
    share, error = swap_share(found, expected)
    ratio = instances[0].K[0, 0] / instances[0].K[1, 1]
    if error > 0.25:
        report.notes.append(
            f"whether fx and fy are swapped cannot be told from these data: fx / fy is {ratio:.4f}"
        )
    elif share > 0.5 and share > SURE * error:
        words = (
            f"{swap.mistake}: {share:.2f} ± {error:.2f} of what that does to silhouettes is seen"
        )
        report.findings.append(Finding(swap.key, words))
