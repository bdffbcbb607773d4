"""Claims: what a paper says beside what we measured over seeds, and a verdict by rule."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from posecore.arrays import fail, require_choice, require_number

__all__ = ["FEWEST_SEEDS", "Claim", "LedgerTable", "Row", "Verdict", "ledger_table", "verdict"]

HOLDS, IN_PART, NOT_HERE = "holds", "holds in part", "does not hold here"
FEWEST_SEEDS = 3


@dataclass(frozen=True)
class Claim:
    """One sentence of a paper that can be measured: `favoured` is better than `other`.

    Args:
        id: its name, unique in its ledger.
        statement, source: what the paper says, and where: "Table IV".
        better: "higher" or "lower", which of two numbers is the better one.
        favoured, other: the two sides, by the names that the measurement gives them.
        paper: the paper's numbers of the two sides; None where it gives none.
        measurement: the name of the measurement that has both sides.
        unit: of the numbers.
    """

    id: str
    statement: str
    source: str
    better: str
    favoured: str
    other: str
    paper: tuple[float | None, float | None]
    measurement: str
    unit: str = ""

    def __post_init__(self) -> None:
        require_choice("better", self.better, ("higher", "lower"))
        if not isinstance(self.paper, tuple) or len(self.paper) != 2:
            fail("paper", "two numbers", repr(self.paper))
        for number in self.paper:
            if number is not None:
                require_number("paper", number)
        if self.favoured == self.other:
            fail("other", "another side than favoured", repr(self.other))


class Verdict(NamedTuple):
    """`words`, and the mean advantage of the favoured side with its 95 % interval."""

    words: str
    advantage: float
    low: float
    high: float


def verdict(favoured: Sequence[float], other: Sequence[float], better: str) -> Verdict:
    """The rule: the paired difference over seeds, and Student's interval of its mean.

    "holds" if the interval lies on the paper's side of 0, "holds in part" if only the mean does,
    "does not hold here" otherwise. Where all differences are equal the interval is one point.

    Args:
        favoured, other: one number for each seed, in the same order.
        better: "higher" or "lower".

    Raises:
        ValueError: if there are fewer than three seeds, or the two do not pair.
    """
    require_choice("better", better, ("higher", "lower"))
    sides = [
        np.array([require_number(n, v) for v in values])
        for n, values in (("favoured", favoured), ("other", other))
    ]
    count = len(sides[0])
    if count < FEWEST_SEEDS:
        fail("favoured", f"at least {FEWEST_SEEDS} seeds", count)
    if len(sides[1]) != count:
        fail("other", f"{count} seeds as in favoured", len(sides[1]))
    gain = (sides[0] - sides[1]) * (1 if better == "higher" else -1)
    mean = float(gain.mean())
    # Equal differences have a mean that is off by a rounding, and so a spread that is none.
    spread = 0.0 if np.ptp(gain) == 0 else float(gain.std(ddof=1))
    half = float(stdtrit(count - 1, 0.975)) * spread / count**0.5
    words = HOLDS if mean - half > 0 else IN_PART if mean > 0 else NOT_HERE
    return Verdict(words, mean, mean - half, mean + half)


@dataclass(frozen=True)
class Row:
    """A claim with its measured numbers, `values[seed][side]`, and how they were made."""

    claim: Claim
    values: dict[int, dict[str, float]]
    conditions: dict[str, str]
    stale: bool

    def side(self, name: str) -> np.ndarray:
        """The numbers of one side, by rising seed."""
        return np.array([self.values[seed][name] for seed in sorted(self.values)])

    @property
    def verdict(self) -> Verdict:
        """By the rule of `verdict`."""
        claim = self.claim
        return verdict(self.side(claim.favoured), self.side(claim.other), claim.better)


@dataclass(frozen=True, repr=False)
class LedgerTable:
    """Rows of ledgers as the page shows them: `text` where there is no HTML."""

    rows: tuple[Row, ...]

    def __repr__(self) -> str:
        if not self.rows:
            return "No claims have been measured yet."
        lines = []
        for row in self.rows:
            statement, source, paper, here, result = _cells(row)
            lines += [f"{statement} ({source})", f"  paper: {paper}", f"  here:  {here}"]
            lines += [f"  {result}", ""]
        return "\n".join([*lines, self._footnote()])

    def _repr_html_(self) -> str:
        if not self.rows:
            return "<p>No claims have been measured yet.</p>"
        heads = ("Claim", "Source", "Paper", "Here", "Verdict")
        head = "".join(f'<th scope="col">{name}</th>' for name in heads)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in _cells(row)) + "</tr>"
            for row in self.rows
        )
        foot = html.escape(self._footnote())
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table><p>{foot}</p>"

    def _footnote(self) -> str:
        made = {
            f"measured at {row.conditions['scale']} scale over seeds "
            f"{', '.join(map(str, sorted(row.values)))} with posecore {row.conditions['version']} "
            f"on {row.conditions['machine']}": None
            for row in self.rows
        }
        return f"± is the standard deviation over seeds; {'; '.join(made)}."


def ledger_table(rows: Iterable[Row]) -> LedgerTable:
    """Rows of one ledger or of several as a table for the page."""
    return LedgerTable(tuple(rows))


def _cells(row: Row) -> tuple[str, str, str, str, str]:
    claim, result = row.claim, row.verdict
    unit = f" {claim.unit}" if claim.unit else ""
    sides = (claim.favoured, claim.other)
    paper = [f"{s} {n:g}{unit}" for s, n in zip(sides, claim.paper, strict=True) if n is not None]
    here = [f"{s} {row.side(s).mean():.3g} ± {row.side(s).std(ddof=1):.2g}{unit}" for s in sides]
    words = (
        f"{result.words}: advantage {result.advantage:.3g}{unit}, "
        f"95 % interval {result.low:.3g} to {result.high:.3g}"
    )
    stale = "; stale: the code has changed since" if row.stale else ""
    return (
        claim.statement,
        claim.source,
        "; ".join(paper) or "no numbers",
        "; ".join(here),
        words + stale,
    )
