"""Claims: what a paper says beside what we measured over seeds, and a verdict by rule.

A chapter declares each of its claims by name:

    Claim(id="iv_6d", statement="6D errs less than quaternions", source="Table IV, mean",
          measurement="table_iv", favoured=Key("6d", metric="rotation"),
          other=Key("quaternion", metric="rotation"), better="lower", unit="degrees",
          paper=(0.49, 1.52))
"""

from __future__ import annotations

import html
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from book.tools.keys import Key
from book.tools.verdicts import FEWEST_SEEDS, UNDECIDED, Verdict, require_side, verdict
from posecore.arrays import fail, require_number

__all__ = [
    "FEWEST_SEEDS",
    "Claim",
    "LedgerTable",
    "Row",
    "Verdict",
    "ledger_table",
    "measured",
    "verdict",
]

NAMED = 3  # of what makes a row stale


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One sentence that can be measured: `favoured` is better than `other`, or as good.

    Args:
        id: its name, unique in its ledger.
        statement, source: what the paper says, and where: "Table IV".
        measurement: the name of the measurement that has both sides.
        favoured, other: the two sides, by the keys that the measurement gives them.
        better: "higher" or "lower", which of two numbers is the better one; None where the claim is
            that both are equal.
        unit: of the numbers.
        paper: the paper's numbers of the two sides; None where it gives none.
        margin: of a claim that both are equal: how far apart they may be, in `unit`. It comes from
            the paper's own spread or is stated before anything is measured, never from our numbers.
        margin_source: where the margin comes from, in words.
        ours: whether the question is our own, and no paper's.

    Raises:
        ValueError: if it has both a better side and a margin, or neither; a margin that is not
            positive, or without a source; the paper's numbers for a question of our own; or one
            side twice.
    """

    id: str
    statement: str
    source: str
    measurement: str
    favoured: Key
    other: Key
    better: str | None = None
    unit: str = ""
    paper: tuple[float | None, float | None] = (None, None)
    margin: float | None = None
    margin_source: str = ""
    ours: bool = False

    def __post_init__(self) -> None:
        require_side(self.better, self.margin)
        if bool(self.margin_source) != (self.margin is not None):
            fail("margin_source", "words if there is a margin, else none", repr(self.margin_source))
        if not isinstance(self.paper, tuple) or len(self.paper) != 2:
            fail("paper", "two numbers", repr(self.paper))
        for number in self.paper:
            if number is not None:
                require_number("paper", number)
        if self.ours and self.paper != (None, None):
            fail("paper", "no numbers for a question of our own", repr(self.paper))
        for name in ("favoured", "other"):
            if not isinstance(getattr(self, name), Key):
                fail(name, "a Key", repr(getattr(self, name)))
        if self.favoured == self.other:
            fail("other", "another side than favoured", repr(str(self.other)))

    def entry(self) -> dict[str, Any]:
        """The claim as JSON can hold it: keys as their text."""
        sides = {"favoured": str(self.favoured), "other": str(self.other)}
        return asdict(self) | sides | {"paper": list(self.paper)}

    @classmethod
    def from_entry(cls, entry: Mapping[str, Any]) -> Claim:
        """The claim of an `entry`.

        Raises:
            KeyError, TypeError, ValueError: if it is no such entry.
        """
        sides = {name: Key.parse(entry[name]) for name in ("favoured", "other")}
        return cls(**{**entry, **sides, "paper": tuple(entry["paper"])})


@dataclass(frozen=True)
class Row:
    """A claim with its measured numbers, `values[seed][key]`, and how they were made.

    `stale` names what has changed since; empty where nothing has.
    """

    claim: Claim
    values: Mapping[int, Mapping[Key, float]]
    conditions: Mapping[str, Any]
    stale: tuple[str, ...] = ()

    def side(self, key: Key) -> np.ndarray:
        """(seeds,) the numbers of one key, by rising seed."""
        return np.array([self.values[seed][key] for seed in sorted(self.values)])

    @property
    def verdict(self) -> Verdict:
        """By the rule of `verdict`."""
        claim = self.claim
        sides = self.side(claim.favoured), self.side(claim.other)
        return verdict(*sides, claim.better, claim.margin)


def measured(rows: Iterable[Row], measurement: str) -> dict[Key, np.ndarray]:
    """Key -> (seeds,) its numbers by rising seed, of one measurement; empty where it is not there.

    Rows of one ledger that rest on the same measurement share all its numbers.
    """
    for row in rows:
        if row.claim.measurement == measurement:
            return {key: row.side(key) for key in next(iter(row.values.values()))}
    return {}


# The table ----------------------------------------------------------------------------------------


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
        # On a phone the table is pushed sideways, and not the page; elsewhere by the arrow keys.
        box = 'style="overflow-x: auto" tabindex="0" role="region" aria-label="Claims"'
        return f"<div {box}>{table}</div><p>{foot}</p>"

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


def _cells(row: Row) -> tuple[str, str, str, str, str]:
    claim = row.claim
    unit = f" {claim.unit}" if claim.unit else ""
    common, names = _labels(claim.favoured, claim.other)
    paper = [f"{s} {n:g}{unit}" for s, n in zip(names, claim.paper, strict=True) if n is not None]
    if claim.margin is not None:
        paper += [f"equal within {claim.margin:g}{_apart(claim)}: {claim.margin_source}"]
    numbers = [row.side(key) for key in (claim.favoured, claim.other)]
    here = [
        f"{name} {_number(side.mean(), 3)} ± {_number(side.std(ddof=1), 2)}{unit}"
        for name, side in zip(names, numbers, strict=True)
    ]
    return (
        claim.statement,
        claim.source,
        "; ".join(paper) or ("our own question" if claim.ours else "no numbers"),
        f"{common}: {'; '.join(here)}" if common else "; ".join(here),
        _result(row),
    )


def _labels(favoured: Key, other: Key) -> tuple[str, tuple[str, str]]:
    """What both sides have in common, and what each has for itself."""
    one, two = asdict(favoured), asdict(other)
    common = [value for name, value in one.items() if value and value == two[name]]
    own = [
        ", ".join(side[name] for name in one if side[name] and one[name] != two[name]) or "all"
        for side in (one, two)
    ]
    return ", ".join(common), (own[0], own[1])


def _result(row: Row) -> str:
    claim, result = row.claim, row.verdict
    words = (
        f"{result.words}: {'difference' if claim.better is None else 'advantage'} "
        f"{_number(result.difference, 3)}{_apart(claim)}, "
        f"95 % interval {_number(result.low, 3)} to {_number(result.high, 3)}"
    )
    half = f"{_number(result.visible, 3)}{_apart(claim)}"
    if result.words == UNDECIDED and claim.better is None:
        words += f"; equality could be shown within {half} at best"
    elif result.words == UNDECIDED and result.visible > 0:
        words += f"; a difference above {half} could have been seen"
    elif result.words == UNDECIDED:
        words += "; both sides are equal in every seed"
    if row.stale:
        more = f" and {len(row.stale) - NAMED} more" if len(row.stale) > NAMED else ""
        words += f"; stale: {', '.join(row.stale[:NAMED])}{more}"
    return words


def _apart(claim: Claim) -> str:
    """The unit of differences: those of percentages are points."""
    unit = "points" if claim.unit == "%" else claim.unit
    return f" {unit}" if unit else ""


def _number(value: float, digits: int) -> str:
    """So many digits that count, but those before the point in any case: 1234 and not 1.23e+03."""
    return f"{value:.{digits}g}" if abs(value) < 10 ** (digits - 1) else f"{value:.0f}"
