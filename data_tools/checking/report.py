"""What a look at a dataset has shown, and how it is said."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from data_tools.checking.corrections import Correction
from data_tools.checking.sample import Sample

__all__ = ["FITS", "SAID", "Finding", "Report"]

FITS = {"masks": 0.7, "boxes": 0.7, "depth": 0.5}
"""The least median agreement of large objects. Other things stand before an object, and the depth
of what shines is not measured."""
BORDER = 1.5  # pixels by which masks drawn by hand are off all around

SAID = {
    "masks": "masks overlap by {} (median IoU)",
    "depth": "{} of the drawn pixels have the measured depth (median)",
    "boxes": "boxes overlap by {} (median IoU)",
}
"""What is compared -> how its agreement is said."""


@dataclass(frozen=True, eq=False)
class Finding:
    """Something that is off.

    Attributes:
        key: names it, such as "inverse poses".
        words: a sentence that says it.
        evidence: numbers, before and after it was corrected.
        objects: the objects that it is about; None for all.
    """

    key: str
    words: str
    evidence: tuple[str, ...] = ()
    objects: tuple[int, ...] | None = None


@dataclass(eq=False)
class Report:
    """What a look at a dataset has shown.

    Attributes:
        sample: what was looked at.
        kind: what models were compared with: "masks", "depth" or "boxes".
        scores: (N,) agreement of the sample's instances as given.
        corrections: for each instance what makes it fit, if anything does.
        fixed: (N,) agreement with that.
        findings: what is off; none if all is fine.
        facts: what was measured.
        notes: what cannot be told, and why.
    """

    sample: Sample
    kind: str
    scores: np.ndarray
    corrections: list[Correction]
    fixed: np.ndarray
    findings: list[Finding] = field(default_factory=list)
    facts: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def least(self) -> float:
        """The least median agreement of what fits: less for small objects, which are all border."""
        masks = [i.mask for i in self.sample.instances if i.mask is not None]
        if self.kind != "masks" or not masks:
            return FITS[self.kind]
        radius = float(np.median([np.sqrt(np.count_nonzero(mask) / np.pi) for mask in masks]))
        return float(np.clip((1 - BORDER / radius) ** 2, 0.4, FITS[self.kind]))

    @property
    def fine(self) -> bool:
        """Whether nothing is off."""
        return not self.findings

    @property
    def keys(self) -> list[str]:
        """The names of what is off."""
        return [finding.key for finding in self.findings]

    def lines(self) -> Iterator[str]:
        """The report in words, line by line: what was measured, then what is off."""
        sample = self.sample
        yield (
            f"looked at {len(sample.views)} images and {sample.total} objects in them, "
            f"{len(sample.instances)} of which are large enough to compare"
        )
        yield from self.facts
        yield from (f"note: {note}" for note in self.notes)
        if self.fine:
            yield "fine: models, poses, camera and images fit together"
        for finding in self.findings:
            whose = ""
            if finding.objects is not None:
                whose = f"object{'s' * (len(finding.objects) > 1)} "
                whose += ", ".join(map(str, finding.objects)) + ": "
            yield f"OFF: {finding.key}: {whose}{finding.words}"
            yield from (f"     {line}" for line in finding.evidence)
