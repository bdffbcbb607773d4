"""The verdict rule against SciPy's t-test, and the table of claims word for word."""

from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.stats import ttest_1samp

from book.tools.claims import Claim, Row, ledger_table, verdict

CLAIM = Claim(
    "iv_6d", "6D < quaternions", "Table IV", "lower", "6D", "quat", (0.55, 2.5), "iv", "degrees"
)
numbers = st.lists(
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), min_size=3, max_size=8
).map(lambda pairs: tuple(np.array(pairs).T))
directions = st.sampled_from(["higher", "lower"])


# The rule ---------------------------------------------------------------------------------------


@given(numbers, directions)
def test_the_interval_is_that_of_the_paired_t_test(
    sides: tuple[np.ndarray, np.ndarray], better: str
) -> None:
    gain = (sides[0] - sides[1]) * (1 if better == "higher" else -1)
    assume(np.ptp(gain) > 1e-6)
    result = verdict(*sides, better)
    interval = ttest_1samp(gain, 0).confidence_interval(0.95)
    assert np.allclose([result.low, result.high], interval, rtol=1e-9, atol=1e-9)
    assert np.isclose(result.advantage, gain.mean(), atol=1e-12)
    if abs(interval.low) > 1e-6 and abs(gain.mean()) > 1e-6:
        expected = "holds" if interval.low > 0 else "holds in part" if gain.mean() > 0 else ""
        assert result.words == (expected or "does not hold here")


@given(numbers, directions)
def test_turning_all_signs_and_the_direction_changes_nothing(
    sides: tuple[np.ndarray, np.ndarray], better: str
) -> None:
    a, b = sides
    result = verdict(a, b, better)
    other = "lower" if better == "higher" else "higher"
    assert verdict(-a, -b, other) == result
    assert verdict(b, a, other) == result
    swapped = verdict(b, a, better)
    assert (swapped.advantage, swapped.low, swapped.high) == (
        -result.advantage,
        -result.high,
        -result.low,
    )
    assert not (result.advantage > 0 and swapped.words != "does not hold here")


@given(numbers, directions, st.integers(-1000, 1000), st.sampled_from([0.25, 1.0, 8.0]))
def test_shift_and_unit_do_not_matter(
    sides: tuple[np.ndarray, np.ndarray], better: str, shift: int, factor: float
) -> None:
    a, b = (np.round(side * 64) / 64 for side in sides)  # so that adding is exact
    result = verdict(a, b, better)
    moved = verdict(factor * (a + shift), factor * (b + shift), better)
    assert moved.words == result.words
    assert np.allclose(moved[1:], factor * np.array(result[1:]), rtol=1e-12, atol=0)


@given(numbers, directions, st.randoms())
def test_the_order_of_seeds_does_not_matter(sides: tuple, better: str, random: object) -> None:
    order = list(range(len(sides[0])))
    random.shuffle(order)
    one, two = verdict(*sides, better), verdict(sides[0][order], sides[1][order], better)
    assert np.allclose(one[1:], two[1:], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("favoured", "other", "better", "words"),
    [
        ([2, 2.1, 1.9], [1, 1, 1], "higher", "holds"),
        ([2, 2.1, 1.9], [1, 1, 1], "lower", "does not hold here"),
        ([2, 0.9, 1.9], [1, 1, 1], "higher", "holds in part"),
        ([1, 1, 1], [2, 2, 2], "lower", "holds"),
        ([1, 1, 1], [1, 1, 1], "lower", "does not hold here"),
        ([1, 2, 3], [1, 2, 3], "higher", "does not hold here"),
        ([0, 1, 2], [1, 1, 1], "higher", "does not hold here"),  # the mean is exactly 0
        ([0.1 + 0.2] * 3, [0.3] * 3, "higher", "holds"),  # equal differences are one point
        # Paired: far more spread between seeds than between the sides.
        ([1.1, 51.11, 101.1], [1, 51, 101], "higher", "holds"),
    ],
)
def test_cases(favoured: list[float], other: list[float], better: str, words: str) -> None:
    assert verdict(favoured, other, better).words == words


@pytest.mark.parametrize(
    ("gains", "advantage", "low", "high", "words"),
    [
        # Standard deviation 1; t(2 degrees of freedom) = 4.30265; 4.30265 / sqrt(3) = 2.48414.
        ([1, 2, 3], 2, -0.48414, 4.48414, "holds in part"),
        ([2, 3, 4], 3, 0.51586, 5.48414, "holds"),
        ([-3, -2, -1], -2, -4.48414, 0.48414, "does not hold here"),
        # Deviations -2, -1, 0, 1, 2: sqrt(10 / 4) = 1.58114; t(4) = 2.77645; times / sqrt(5).
        ([0, 1, 2, 3, 4], 2, 0.03676, 3.96324, "holds"),
        ([-1, 0, 1, 2, 3], 1, -0.96324, 2.96324, "holds in part"),
    ],
)
def test_the_rule_worked_out_by_hand(
    gains: list[float], advantage: float, low: float, high: float, words: str
) -> None:
    other = [10 + 7 * seed for seed in range(len(gains))]
    for better, sign in (("higher", 1), ("lower", -1)):
        favoured = [b + sign * gain for b, gain in zip(other, gains, strict=True)]
        result = verdict(favoured, other, better)
        assert result.words == words
        assert result[1:] == pytest.approx((advantage, low, high), abs=5e-5)


def test_numbers_are_written_without_powers_of_ten() -> None:
    values = {seed: {"6D": 12345.6 + seed, "quat": 25000.0 * seed} for seed in (1, 2, 3)}
    text = repr(ledger_table([Row(CLAIM, values, CONDITIONS, False)]))
    assert "here:  6D 12348 ± 1 degrees; quat 50000 ± 25000 degrees" in text
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


def test_equal_differences_that_round_have_no_spread() -> None:
    result = verdict([0.1, 0.1, 0.1], [0, 0, 0], "higher")
    assert result.low == result.advantage == result.high
    assert np.isclose(result.advantage, 0.1, rtol=1e-15)


# The table --------------------------------------------------------------------------------------

CONDITIONS = {
    "module": "m",
    "function": "f",
    "code": "0",
    "scale": "book",
    "version": "0.1.0",
    "machine": "Linux",
}
VALUES = {
    10: {"6D": 0.7, "quat": 2.75, "more": 1.0},
    2: {"6D": 0.5, "quat": 2.5, "more": 1.0},
    3: {"6D": 0.6, "quat": 2.25, "more": 1.0},
}
ROW = Row(CLAIM, VALUES, CONDITIONS, False)


def test_a_row_orders_its_seeds_by_number() -> None:
    assert ROW.side("6D").tolist() == [0.5, 0.6, 0.7]
    assert ROW.side("quat").tolist() == [2.5, 2.25, 2.75]
    assert ROW.verdict == verdict([0.5, 0.6, 0.7], [2.5, 2.25, 2.75], "lower")


def test_the_table_as_text() -> None:
    words = replace(CLAIM, better="higher", paper=(None, None), unit="", statement="Other")
    rows = [ROW, Row(words, VALUES, CONDITIONS | {"scale": "tiny"}, True)]
    assert repr(ledger_table(rows)) == (
        "6D < quaternions (Table IV)\n"
        "  paper: 6D 0.55 degrees; quat 2.5 degrees\n"
        "  here:  6D 0.6 ± 0.1 degrees; quat 2.5 ± 0.25 degrees\n"
        "  holds: advantage 1.9 degrees, 95 % interval 1.36 to 2.44\n"
        "\n"
        "Other (Table IV)\n"
        "  paper: no numbers\n"
        "  here:  6D 0.6 ± 0.1; quat 2.5 ± 0.25\n"
        "  does not hold here: advantage -1.9, 95 % interval -2.44 to -1.36; "
        "stale: the code has changed since\n"
        "\n"
        "± is the standard deviation over seeds; "
        "measured at book scale over seeds 2, 3, 10 with posecore 0.1.0 on Linux; "
        "measured at tiny scale over seeds 2, 3, 10 with posecore 0.1.0 on Linux."
    )


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
    table = ledger_table([ROW, replace(ROW, stale=True)])
    cells = Cells(table._repr_html_())
    assert not cells.open
    heads = [text for tag, text in cells.texts if tag == "th"]
    assert heads == ["Claim", "Source", "Paper", "Here", "Verdict"]
    texts = [text for tag, text in cells.texts if tag == "td"]
    assert len(texts) == 10 and texts[0] == "6D < quaternions"
    for text in texts + [text for tag, text in cells.texts if tag == "p"]:
        assert text in repr(table)
    assert [text.endswith("stale: the code has changed since") for text in texts[4::5]] == [0, 1]


def test_an_empty_table() -> None:
    assert repr(ledger_table([])) == "No claims have been measured yet."
    assert ledger_table([])._repr_html_() == "<p>No claims have been measured yet.</p>"


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: verdict([1, 2], [1, 2], "lower"),
            "favoured: expected at least 3 seeds, got 2",
        ),
        (lambda: verdict([], [], "lower"), "favoured: expected at least 3 seeds, got 0"),
        (
            lambda: verdict([1, 2, 3], [1, 2], "lower"),
            "other: expected 3 seeds as in favoured, got 2",
        ),
        (
            lambda: verdict([1, 2, np.nan], [1, 2, 3], "lower"),
            "favoured: expected a finite number, got nan",
        ),
        (
            lambda: verdict([1, 2, 3], [1, 2, np.inf], "lower"),
            "other: expected a finite number, got inf",
        ),
        (
            lambda: verdict([1, 2, 3], [1, 2, "x"], "lower"),
            "other: expected a finite number, got 'x'",
        ),
        (
            lambda: verdict([1, 2, 3], [1, 2, 3], "best"),
            "better: expected one of 'higher', 'lower', got 'best'",
        ),
        (
            lambda: replace(CLAIM, better="less"),
            "better: expected one of 'higher', 'lower', got 'less'",
        ),
        (lambda: replace(CLAIM, paper=(1.0,)), "paper: expected two numbers, got (1.0,)"),
        (lambda: replace(CLAIM, paper=3.0), "paper: expected two numbers, got 3.0"),
        (
            lambda: replace(CLAIM, paper=(1.0, np.nan)),
            "paper: expected a finite number, got nan",
        ),
        (
            lambda: replace(CLAIM, other="6D"),
            "other: expected another side than favoured, got '6D'",
        ),
    ],
)
def test_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        call()
    assert str(caught.value) == message
