"""Poses, models, cameras and masks: what of them is off, for all objects or for some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data_tools.checking import depths, fits, wording
from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.explaining import Explanation, explain, scores_of
from data_tools.checking.report import SAID, Finding, Report
from data_tools.checking.sample import Instance

__all__ = ["check"]

OFF = 0.6  # of what all others have: an object or an image that does not fit as they do
NOTICEABLE = 0.08  # less than the others: an object that is worth a look of its own
MOST_NAMED = 5  # images


def check(report: Report) -> None:
    """Look at all objects together, then at those that do not fit as the others do."""
    sample, kind = report.sample, report.kind
    explained = explain(kind, sample, sample.instances, report.scores)
    if explained is not None:
        report.findings.append(_applied(report, explained, sample.instances, None))
    merged: dict[str, Finding] = {}
    lost: list[int] = []  # instances of objects that nobody can explain
    wrong_masks = explained is not None and explained.correction.targets is not None
    for object_id in sorted({i.object_id for i in sample.instances} if not wrong_masks else ()):
        mine = [i for i in sample.instances if i.object_id == object_id]
        numbers = [i.number for i in mine]
        others = np.delete(report.fixed, numbers)
        usual = float(np.median(others)) if len(others) else 1.0
        own = float(np.median(report.fixed[numbers]))
        if own >= report.least and own >= usual - NOTICEABLE:
            continue
        explained = explain(kind, sample, mine, report.scores[numbers])
        if explained is not None and _repairs(own, explained.after):
            finding = _applied(report, explained, mine, (object_id,))
            before = merged.get(finding.words)
            ids = (object_id,) if before is None else (*before.objects, object_id)
            merged[finding.words] = replace(before or finding, objects=ids)
        elif own < OFF * usual and usual >= report.least and len(others):
            lost += numbers
            words = (
                f"{SAID[kind].format(f'{own:.2f}')}, {usual:.2f} those of the others; none of the "
                "known mistakes explains it"
            )
            merged[str(object_id)] = Finding(
                "an object that does not fit", words, objects=(object_id,)
            )
    report.findings += merged.values()
    _judge(report, np.setdiff1d(np.arange(len(report.fixed)), lost), not wrong_masks)


def _repairs(before: float, after: float) -> bool:
    """Whether it is worth to name an object of its own: with few instances much fits by chance."""
    return after >= before + 0.1 and 1 - after <= 0.5 * (1 - before)


def _judge(report: Report, numbers: np.ndarray, each: bool) -> None:
    """Say how well all fits in the end, and if `each` is to be named, which images do not."""
    kind = report.kind
    # An image without a neighbour cannot have its poses.
    placed = [
        report.corrections[n].place(i) is not None for n, i in enumerate(report.sample.instances)
    ]
    numbers = numbers[np.array(placed)[numbers]]
    fixed = report.fixed[numbers]
    typical = float(np.median(fixed))
    low = float(np.quantile(fixed, 0.1))
    said = SAID[kind].format(f"{typical:.2f}")
    end = " once corrected" if report.findings else ""
    if kind != "depth":  # of which more is said later
        report.facts.append(f"{kind}: {said}{end}, {low:.2f} or less for a tenth of the objects")
    if typical < report.least:
        words = f"{said}, and none of the known mistakes explains it; look at the pictures"
        report.findings.append(Finding("models and images do not fit", words))
        return
    bad = []
    for index, view in report.sample.views.items():
        of_view = [n for n in numbers if report.sample.instances[n].view == index]
        if (
            of_view
            and np.median(report.fixed[of_view]) < OFF * typical
            and kind != "depth"
            and each
        ):
            name = f"scene {view.scene_id}, image {view.image_id}"
            bad.append(f"{name}: {np.median(report.fixed[of_view]):.2f}")
    if bad:
        more = f" and {len(bad) - MOST_NAMED} more" if len(bad) > MOST_NAMED else ""
        words = f"in these alone models and {kind} do not fit: {'; '.join(bad[:MOST_NAMED])}{more}"
        report.findings.append(Finding("single images", words))


def _applied(
    report: Report,
    explained: Explanation,
    instances: Sequence[Instance],
    objects: tuple[int, ...] | None,
) -> Finding:
    """The finding of an explanation, whose correction is applied to the instances."""
    kind, correction = report.kind, explained.correction
    key, words, remedy = correction.key, correction.mistake, correction.remedy
    evidence = []
    if correction.factor != 1:
        owner = correction.owner
        if owner is None:
            owner = depths.whose_factor(instances, correction.place, correction.factor)
            if owner is None:
                owner = wording.plausible_owner(instances, correction.factor)
        key, words, remedy = wording.scale_words(correction, owner)
        correction = fits.with_owner(correction, owner)
    if correction.depth != 1 and not wording.sizes_plausible(instances):
        key, words, remedy = wording.all_lengths(correction.depth)
    before, after = SAID[kind].format(f"{explained.before:.2f}"), f"{explained.after:.2f}"
    evidence.append(f"{before} as given; {after} with {remedy}")
    free = [depths.corrected(instance, correction) for instance in instances]
    state = None if kind == "depth" else depths.depth_state(free, correction.place)
    if correction.targets is not None and state is not None and state.agrees:
        evidence.append(f"depth agrees with the poses as given, in {state.share:.2f} of the pixels")
    elif state is not None:
        was = depths.depth_state(free, AS_GIVEN.place)
        given = "cannot be compared" if was is None else f"agrees in {was.share:.2f} of the pixels"
        evidence.append(f"depth {given} as given; in {state.share:.2f} with that")
    evidence += [f"as likely by these data: {other.mistake}" for other in explained.others]
    if objects is not None and correction.factor != 1:
        words = words.replace("the models are", "its model is")
    numbers = [instance.number for instance in instances]
    for number in numbers:
        report.corrections[number] = correction
    report.fixed[numbers] = scores_of(kind, instances, correction)
    return Finding(key, words, tuple(evidence), objects)
