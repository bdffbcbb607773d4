"""What a claim may be, its row, and the table of claims word for word."""

import json
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from book.tools.claims import Claim, Row, ledger_table, measured, verdict
from book.tools.keys import Key

SIX, QUAT = Key("6D", metric="rotation"), Key("quat", metric="rotation")
CLAIM = Claim(
    id="iv_6d",
    statement="6D < quaternions",
    source="Table IV",
    measurement="iv",
    favoured=SIX,
    other=QUAT,
    better="lower",
    unit="degrees",
    paper=(0.55, 2.5),
)
EQUAL = replace(CLAIM, better=None, margin=0.25, margin_source="Table IV's own spread")
CONDITIONS = {"scale": "book", "version": "0.1.0", "machine": "Linux"}
VALUES = {
    10: {SIX: 0.7, QUAT: 2.75, Key("more"): 1.0},
    2: {SIX: 0.5, QUAT: 2.5, Key("more"): 1.0},
    3: {SIX: 0.6, QUAT: 2.25, Key("more"): 1.0},
}
ROW = Row(CLAIM, VALUES, CONDITIONS)


def row(claim: Claim, gains: list[float]) -> Row:
    """A row whose sides differ by so much, seed by seed."""
    values = {seed: {SIX: 10.0 + gain, QUAT: 10.0} for seed, gain in enumerate(gains)}
    return Row(claim, values, CONDITIONS)


# Rows -------------------------------------------------------------------------------------------


def test_a_row_orders_its_seeds_by_number() -> None:
    assert ROW.side(SIX).tolist() == [0.5, 0.6, 0.7]
    assert ROW.side(QUAT).tolist() == [2.5, 2.25, 2.75]
    assert ROW.verdict == verdict([0.5, 0.6, 0.7], [2.5, 2.25, 2.75], "lower")
    assert ROW.stale == ()


def test_a_row_of_equality_is_judged_by_its_margin() -> None:
    gains = [0.1, 0.2, 0.0]
    assert row(EQUAL, gains).verdict == verdict([10.1, 10.2, 10.0], [10.0, 10.0, 10.0], margin=0.25)
    assert row(EQUAL, [0.1, 0.1, 0.1]).verdict.words == "holds"
    assert row(EQUAL, gains).verdict.words == "undecided"
    assert row(EQUAL, [-3.0, -3.1, -3.2]).verdict.words == "contradicted here"


def test_the_numbers_of_a_measurement_are_found_in_the_rows() -> None:
    other = replace(CLAIM, measurement="two")
    rows = [ROW, Row(other, {0: {SIX: 1.0}, 1: {SIX: 3.0}}, CONDITIONS)]
    assert {key: side.tolist() for key, side in measured(rows, "iv").items()} == {
        SIX: [0.5, 0.6, 0.7],
        QUAT: [2.5, 2.25, 2.75],
        Key("more"): [1.0, 1.0, 1.0],
    }
    assert measured(rows, "two")[SIX].tolist() == [1, 3]
    assert measured(rows, "three") == measured([], "iv") == {}


@pytest.mark.parametrize("claim", [CLAIM, EQUAL, replace(CLAIM, paper=(None, None), ours=True)])
def test_a_claim_is_read_back_from_what_json_keeps_of_it(claim: Claim) -> None:
    entry = json.loads(json.dumps(claim.entry()))
    assert Claim.from_entry(entry) == claim
    assert entry["favoured"] == "method=6D; metric=rotation"


@pytest.mark.parametrize(
    "change",
    [{"favoured": "6D"}, {"other": None}, {"paper": 3}, {"strange": 1}, {"better": "less"}],
)
def test_a_damaged_entry_is_refused(change: dict) -> None:
    with pytest.raises((KeyError, TypeError, ValueError)):
        Claim.from_entry(CLAIM.entry() | change)


# The table --------------------------------------------------------------------------------------


def test_numbers_are_written_without_powers_of_ten() -> None:
    values = {seed: {SIX: 12345.6 + seed, QUAT: 25000.0 * seed} for seed in (1, 2, 3)}
    text = repr(ledger_table([Row(CLAIM, values, CONDITIONS)]))
    assert "here:  rotation: 6D 12348 ± 1 degrees; quat 50000 ± 25000 degrees" in text
    assert "e+" not in text


def test_rows_stand_under_the_names_of_their_pages() -> None:
    table = ledger_table({"01_a": [ROW, ROW], "02_<b>": [ROW], "03_none": []})
    lines = repr(table).splitlines()
    assert lines[:4] == ["01_a", "----", "", "6D < quaternions (Table IV)"]
    assert [lines.count(name) for name in ("01_a", "02_<b>", "03_none")] == [1, 1, 0]
    cells = Cells(table._repr_html_())
    assert not cells.open
    heads = [text for tag, text in cells.texts if tag == "th"]
    assert heads == ["Claim", "Source", "Paper", "Here", "Verdict", "01_a", "02_<b>"]
    plain = repr(ledger_table([ROW, ROW, ROW]))
    assert [line for line in lines if line[:2] not in ("01", "02", "--")].count("") >= 3
    assert repr(table).endswith(plain.splitlines()[-1])
    assert repr(ledger_table({})) == "No claims have been measured yet."
    assert ledger_table([ROW]).rows == ledger_table({"": [ROW]}).rows


def test_the_table_as_text() -> None:
    words = replace(CLAIM, better="higher", paper=(None, None), unit="", statement="Other")
    rows = [ROW, Row(words, VALUES, CONDITIONS | {"scale": "tiny"}, ("shading.lit",))]
    assert repr(ledger_table(rows)) == (
        "6D < quaternions (Table IV)\n"
        "  paper: 6D 0.55 degrees; quat 2.5 degrees\n"
        "  here:  rotation: 6D 0.6 ± 0.1 degrees; quat 2.5 ± 0.25 degrees\n"
        "  holds: advantage 1.9 degrees, 95 % interval 1.36 to 2.44\n"
        "\n"
        "Other (Table IV)\n"
        "  paper: no numbers\n"
        "  here:  rotation: 6D 0.6 ± 0.1; quat 2.5 ± 0.25\n"
        "  contradicted here: advantage -1.9, 95 % interval -2.44 to -1.36; stale: shading.lit\n"
        "\n"
        "± is the standard deviation over seeds; "
        "measured at book scale over seeds 2, 3, 10 with posecore 0.1.0 on Linux; "
        "measured at tiny scale over seeds 2, 3, 10 with posecore 0.1.0 on Linux."
    )


def lines(row: Row) -> list[str]:
    return [line.strip() for line in repr(ledger_table([row])).splitlines()]


def test_an_undecided_row_says_what_could_have_been_seen() -> None:
    percent = replace(CLAIM, better="higher", unit="%")
    assert lines(row(percent, [1.0, 2.0, 3.0]))[3] == (
        "undecided: advantage 2 points, 95 % interval -0.484 to 4.48; "
        "a difference above 2.48 points could have been seen"
    )
    assert lines(row(percent, [0.0, 0.0, 0.0]))[3] == (
        "undecided: advantage 0 points, 95 % interval 0 to 0; both sides are equal in every seed"
    )


def test_a_row_of_equality_says_its_margin_and_where_that_is_from() -> None:
    text = lines(row(EQUAL, [1.0, 2.0, 3.0]))
    assert text[1] == (
        "paper: 6D 0.55 degrees; quat 2.5 degrees; equal within 0.25 degrees: Table IV's own spread"
    )
    assert text[3] == (
        "undecided: difference 2 degrees, 95 % interval -0.484 to 4.48; "
        "equality could be shown within 2.48 degrees at best"
    )
    assert lines(row(EQUAL, [0.0, 0.0, 0.0]))[3] == (
        "holds: difference 0 degrees, 95 % interval 0 to 0"
    )


def test_a_question_of_our_own_is_marked() -> None:
    ours = replace(CLAIM, paper=(None, None), ours=True)
    assert lines(row(ours, [1.0, 2.0, 3.0]))[1] == "paper: our own question"


@pytest.mark.parametrize(
    ("favoured", "other", "here"),
    [
        (Key("a", "easy", "add"), Key("b", "easy", "add"), "easy, add: a 1 ± 0; b 2 ± 0"),
        (Key("a", "new"), Key("a", "old"), "a: new 1 ± 0; old 2 ± 0"),
        (Key("a", "easy"), Key("b", "hard"), "a, easy 1 ± 0; b, hard 2 ± 0"),
        (Key("a", group="cat"), Key("a"), "a: cat 1 ± 0; all 2 ± 0"),
    ],
)
def test_sides_are_named_by_what_they_differ_in(favoured: Key, other: Key, here: str) -> None:
    claim = replace(CLAIM, favoured=favoured, other=other, unit="", paper=(None, None))
    values = {seed: {favoured: 1.0, other: 2.0} for seed in range(3)}
    assert lines(Row(claim, values, CONDITIONS))[2] == f"here:  {here}"


@pytest.mark.parametrize(
    ("stale", "said"),
    [
        (("a",), "; stale: a"),
        (("a", "b", "c"), "; stale: a, b, c"),
        (("a", "b", "c", "d"), "; stale: a, b, c and 1 more"),
        (tuple("abcdef"), "; stale: a, b, c and 3 more"),
    ],
)
def test_a_stale_row_names_at_most_three_reasons(stale: tuple[str, ...], said: str) -> None:
    fresh = lines(ROW)[3]
    assert lines(replace(ROW, stale=stale))[3] == fresh + said


class Cells(HTMLParser):
    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open[-1], data))


def test_the_table_as_html_says_the_same() -> None:
    table = ledger_table([ROW, replace(ROW, stale=("a<b",)), row(EQUAL, [1.0, 2.0, 3.0])])
    cells = Cells(table._repr_html_())
    assert not cells.open and "a&lt;b" in table._repr_html_()
    heads = [text for tag, text in cells.texts if tag == "th"]
    assert heads == ["Claim", "Source", "Paper", "Here", "Verdict"]
    texts = [text for tag, text in cells.texts if tag == "td"]
    assert len(texts) == 15 and texts[0] == "6D < quaternions"
    for text in texts + [text for tag, text in cells.texts if tag == "p"]:
        assert text in repr(table)
    assert [text.endswith("stale: a<b") for text in texts[4::5]] == [0, 1, 0]


def test_an_empty_table() -> None:
    assert repr(ledger_table([])) == "No claims have been measured yet."
    assert ledger_table([])._repr_html_() == "<p>No claims have been measured yet.</p>"


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: replace(CLAIM, better="less"),
            "better: expected one of 'higher', 'lower', got 'less'",
        ),
        (
            lambda: replace(CLAIM, better=None),
            "better: expected one of 'higher', 'lower', got None",
        ),
        (
            lambda: replace(EQUAL, better="lower"),
            "better: expected None beside a margin, got 'lower'",
        ),
        (lambda: replace(EQUAL, margin=0.0), "margin: expected a finite number above 0, got 0.0"),
        (
            lambda: replace(EQUAL, margin=np.nan),
            "margin: expected a finite number above 0, got nan",
        ),
        (
            lambda: replace(EQUAL, margin_source=""),
            "margin_source: expected words if there is a margin, else none, got ''",
        ),
        (
            lambda: replace(CLAIM, margin_source="x"),
            "margin_source: expected words if there is a margin, else none, got 'x'",
        ),
        (
            lambda: replace(CLAIM, ours=True),
            "paper: expected no numbers for a question of our own, got (0.55, 2.5)",
        ),
        (lambda: replace(CLAIM, paper=(1.0,)), "paper: expected two numbers, got (1.0,)"),
        (lambda: replace(CLAIM, paper=3.0), "paper: expected two numbers, got 3.0"),
        (
            lambda: replace(CLAIM, paper=(1.0, np.nan)),
            "paper: expected a finite number, got nan",
        ),
        (lambda: replace(CLAIM, favoured="6D"), "favoured: expected a Key, got '6D'"),
        (
            lambda: replace(CLAIM, other=SIX),
            "other: expected another side than favoured, got 'method=6D; metric=rotation'",
        ),
    ],
)
def test_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        call()
    assert str(caught.value) == message
