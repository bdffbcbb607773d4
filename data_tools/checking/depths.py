"""Measured depth against that of the drawn models: units, rays, images of another moment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_tools.checking import wording
from data_tools.checking.agreement import DepthFit, depth_fit
from data_tools.checking.corrections import AS_GIVEN, Correction, Place
from data_tools.checking.drawing import Placement, draw
from data_tools.checking.report import Finding, Report
from data_tools.checking.sample import Instance, Sample

__all__ = [
    "DepthMistake",
    "DepthState",
    "check",
    "corrected",
    "depth_mistake",
    "depth_state",
    "unit_correction",
    "whose_factor",
]

AGREES = 0.5  # share of pixels, in half of the objects: others may be before them, or shine
NEAR = 0.05  # relative: a ratio so near to 1 is no unit
SURE = 4.0  # standard errors
CONSISTENT = 0.15  # spread of the logarithm of the ratios, to that of the ratio itself

Measured = Callable[[Instance], np.ndarray | None]
"""The depth image (H, W) that an instance is compared with."""


@dataclass(frozen=True)
class DepthState:
    """Medians over objects; see `DepthFit`.

    Attributes:
        ratio, offset, share, ray_share: as there.
        spread: median deviation of the logarithm of the ratios from their median.
        count: objects that could be compared.
        slope, slope_error: of the logarithm of the ratios on that of the rays' lengths, and its
            standard error: 0 where the images hold z, 1 where they hold these lengths.
    """

    ratio: float
    offset: float
    share: float
    ray_share: float
    spread: float
    count: int
    slope: float
    slope_error: float

    @property
    def of_rays(self) -> bool:
        """Whether the images clearly hold lengths of rays."""
        return abs(self.slope - 1) < 0.4 and self.slope > SURE * self.slope_error

    @property
    def agrees(self) -> bool:
        """Whether the depth images have the objects where the poses have them."""
        near = self.share >= AGREES and abs(np.log(self.ratio)) < NEAR
        return near and not self.of_rays


@dataclass(frozen=True)
class DepthMistake:
    """What is wrong with depth.

    Attributes:
        key, mistake, remedy: as of a `Correction`.
        before, after: median shares of pixels that agree.
        factor: measured over expected, where that is the mistake; else 1.
    """

    key: str
    mistake: str
    remedy: str
    before: float
    after: float
    factor: float = 1.0


def check(report: Report) -> None:
    """Units of depth, and whether it is of these images."""
    instances = [corrected(i, report.corrections[i.number]) for i in report.sample.instances]
    instances = [i for i in instances if i.depth is not None]

    def place(instance: Instance) -> Placement | None:
        return report.corrections[instance.number].place(instance)

    state = depth_state(instances, place)
    if state is None:
        if instances:
            report.notes.append("depth: too few pixels can be compared with the models")
        return
    end = " once corrected" if report.findings else ""
    report.facts.append(
        f"depth: {state.share:.2f} of the pixels are within 3 % of the drawn models{end} (median "
        f"of {state.count} objects), measured / drawn is {state.ratio:.3f}, measured - drawn "
        f"{1000 * state.offset:+.1f} mm"
    )
    if state.agrees:
        return
    mistake = depth_mistake(report.sample, instances, place, state)
    if mistake is None:
        if report.kind != "depth" and not report.findings:
            words = "depth and poses do not agree, and none of the known mistakes explains it"
            report.findings.append(Finding("depth does not fit", words))
        return
    key, words, remedy = mistake.key, mistake.mistake, mistake.remedy
    if mistake.factor != 1 and not wording.sizes_plausible(instances):
        key, words, remedy = wording.all_lengths(mistake.factor)
    evidence = (
        f"{mistake.before:.2f} of the pixels agree as given; {mistake.after:.2f} with {remedy}"
    )
    report.findings.append(Finding(key, words, (evidence,)))


def corrected(instance: Instance, correction: Correction) -> Instance:
    """The instance with its depth corrected, and without a mask of what is seen that is wrong."""
    if correction.targets is None and correction.depth == 1:
        return instance
    visible = instance.visible if correction.targets is None else None
    return replace(instance, visible=visible, depth=_divided(instance.depth, correction.depth))


def depth_state(
    instances: Sequence[Instance], place: Place, measured: Measured | None = None
) -> DepthState | None:
    """Compare depth with the models, drawn as `place` says; None where nothing can be compared."""
    fits = list(_fits(instances, place, measured or (lambda instance: instance.depth)))
    if not fits:
        return None
    ratio, offset, share, ray_share, _ = np.median(np.array(fits), 0).tolist()
    logs, rays = np.log([fit.ratio for fit in fits]), np.log([fit.ray for fit in fits])
    spread = float(np.median(np.abs(logs - np.log(ratio))))
    slope = _slope(rays, logs)
    return DepthState(ratio, offset, share, ray_share, spread, len(fits), *slope)


def depth_mistake(
    sample: Sample, instances: Sequence[Instance], place: Place, state: DepthState
) -> DepthMistake | None:
    """Why depth does not agree: another unit, rays' lengths, or another image's depth.

    Args:
        sample: that the instances are of.
        instances: with depth.
        place: where each is drawn.
        state: as given.

    Returns:
        None if none of that explains it.
    """
    found = []
    unit = unit_correction(state)
    if unit is not None:
        after = depth_state(instances, place, lambda i: _divided(i.depth, unit.depth))
        if after is not None:
            words = unit.key, unit.mistake, unit.remedy
            found.append(DepthMistake(*words, state.share, after.share, unit.depth))
    found.append(
        DepthMistake(
            "lengths of rays",
            "the depth images hold distances from the camera's centre, where they should hold z, "
            "along its axis",
            "distances turned into z",
            state.share,
            state.ray_share,
        )
    )
    for offset, name in ((1, "next"), (-1, "previous")):
        after = depth_state(instances, place, _of_neighbour(sample, offset))
        if after is not None and after.count >= max(2, state.count / 3):
            found.append(
                DepthMistake(
                    "depth shifted by one image",
                    f"the depth images belong to other images: that of the {name} one fits",
                    f"the depth image of the {name} image",
                    state.share,
                    after.share,
                )
            )
    best = max(found, key=lambda one: one.after)
    clear = best.after >= AGREES and best.after >= state.share + 0.15
    if best.key == "lengths of rays":
        clear = state.of_rays and best.after > state.share
    return best if clear else None


def unit_correction(state: DepthState) -> Correction | None:
    """The unit of depth that a state speaks for; None where ratios differ, or there is none."""
    log = np.log(state.ratio)
    if abs(log) < NEAR or state.spread >= CONSISTENT * abs(log):
        return None
    factor = wording.near_unit(state.ratio)
    return Correction(
        "depth unit",
        f"the depth images are {wording.times(factor)}: their unit is not what is said of it, in "
        "BOP by depth_scale",
        f"depth divided by {wording.number(factor)}",
        AS_GIVEN.place,
        depth=factor,
    )


def whose_factor(instances: Sequence[Instance], place: Place, factor: float) -> str | None:
    """Whether models are to grow by a factor or translations to shrink by it, as depth has it.

    Args:
        instances: with depth.
        place: where each is drawn with a model that was enlarged.
        factor: by which.

    Returns:
        "models" or "translations", or None if depth does not tell.
    """
    grown = depth_state(instances, place)
    if grown is None:
        return None
    # Were all lengths divided by the factor, the drawn depths were, too.
    logs = [abs(np.log(grown.ratio)), abs(np.log(grown.ratio * factor))]
    if min(logs) > 0.35 * abs(np.log(factor)):
        return None
    return "models" if logs[0] < logs[1] else "translations"


def _fits(instances: Sequence[Instance], place: Place, measured: Measured) -> Iterator[DepthFit]:
    for instance in instances:
        image, placed = measured(instance), place(instance)
        if image is None or placed is None:
            continue
        fit = depth_fit(instance, draw(instance.shape, placed, instance.size)[1], image)
        if fit is not None:
            yield fit


def _slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Of y on x, and its standard error; outliers of y are left out."""
    kept = np.abs(y - np.median(y)) <= 5 * np.median(np.abs(y - np.median(y))) + 1e-4
    x, y = x[kept] - x[kept].mean(), y[kept] - y[kept].mean()
    power = float((x**2).sum())
    if len(x) < 5 or power < 1e-12:
        return 0.0, np.inf
    slope = float((x * y).sum() / power)
    noise = float(((y - slope * x) ** 2).sum()) / (len(x) - 2)
    return slope, float(np.sqrt(noise / power))


def _divided(depth: np.ndarray | None, factor: float) -> np.ndarray | None:
    return None if depth is None else depth / factor


def _of_neighbour(sample: Sample, offset: int) -> Measured:
    def measured(instance: Instance) -> np.ndarray | None:
        view = sample.neighbour_view(instance.view, offset)
        return None if view is None else view.depth

    return measured
