"""Claims: what a paper says beside what we measured over seeds, and a verdict by rule."""

from __future__ import annotations

import html
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
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
    """Rows of ledgers as a page shows them; each under the name of its group, if it has one."""

    rows: tuple[Row, ...]
    groups: tuple[str, ...] = ()

    def __repr__(self) -> str:
        if not self.rows:
            return "No claims have been measured yet."
        lines = []
        for group, row in self._grouped():
            statement, source, paper, here, result = _cells(row)
            lines += [group, "-" * len(group), ""] if group else []
            lines += [f"{statement} ({source})", f"  paper: {paper}", f"  here:  {here}"]
            lines += [f"  {result}", ""]
        return "\n".join([*lines, self._footnote()])

    def _repr_html_(self) -> str:
        if not self.rows:
            return "<p>No claims have been measured yet.</p>"
        heads = ("Claim", "Source", "Paper", "Here", "Verdict")
        head = "".join(f'<th scope="col">{name}</th>' for name in heads)
        body = ""
        for group, row in self._grouped():
            if group:
                look = f'colspan="{len(heads)}" scope="colgroup" style="text-align: left"'
                body += f"<tr><th {look}>{html.escape(group)}</th></tr>"
            body += "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in _cells(row))
            body += "</tr>"
        foot = html.escape(self._footnote())
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        # On a phone the table is pushed sideways, and not the page.
        return f'<div style="overflow-x: auto">{table}</div><p>{foot}</p>'

    def _grouped(self) -> Iterator[tuple[str, Row]]:
        """Each row, with the name of its group where that begins."""
        last = ""
        for group, row in itertools.zip_longest(self.groups, self.rows, fillvalue=""):
            yield "" if group == last else group, row
            last = group

    def _footnote(self) -> str:
        made = {
            f"measured at {row.conditions['scale']} scale over seeds "
            f"{', '.join(map(str, sorted(row.values)))} with posecore {row.conditions['version']} "
            f"on {row.conditions['machine']}": None
            for row in self.rows
        }
        return f"± is the standard deviation over seeds; {'; '.join(made)}."


def ledger_table(rows: Iterable[Row] | Mapping[str, Iterable[Row]]) -> LedgerTable:
    """Rows as a table for the page; name -> rows, as from `all_rows`, puts them under names."""
    if not isinstance(rows, Mapping):
        return LedgerTable(tuple(rows))
    named = [(name, row) for name, some in rows.items() for row in some]
    return LedgerTable(tuple(row for _, row in named), tuple(name for name, _ in named))


def _number(value: float, digits: int) -> str:
    """So many digits that count, but those before the point in any case: 1234 and not 1.23e+03."""
    return f"{value:.{digits}g}" if abs(value) < 10 ** (digits - 1) else f"{value:.0f}"


def _cells(row: Row) -> tuple[str, str, str, str, str]:
    claim, result = row.claim, row.verdict
    unit = f" {claim.unit}" if claim.unit else ""
    sides = (claim.favoured, claim.other)
    paper = [f"{s} {n:g}{unit}" for s, n in zip(sides, claim.paper, strict=True) if n is not None]
    here = [
        f"{s} {_number(row.side(s).mean(), 3)} ± {_number(row.side(s).std(ddof=1), 2)}{unit}"
        for s in sides
    ]
    words = (
        f"{result.words}: advantage {_number(result.advantage, 3)}{unit}, "
        f"95 % interval {_number(result.low, 3)} to {_number(result.high, 3)}"
    )
    stale = "; stale: the code has changed since" if row.stale else ""
    return (
        claim.statement,
        claim.source,
        "; ".join(paper) or "no numbers",
        "; ".join(here),
        words + stale,
    )
