"""The verdict's rule against SciPy's t-test, branch by branch."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.stats import ttest_1samp

from book.tools.verdicts import Verdict, verdict

numbers = st.lists(
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), min_size=3, max_size=8
).map(lambda pairs: tuple(np.array(pairs).T))
directions = st.sampled_from(["higher", "lower"])
margins = st.floats(1e-2, 1e4)
FAR = 1e-6  # from a border, where SciPy's rounding and ours may differ


def interval(gain: np.ndarray) -> tuple[float, float]:
    found = ttest_1samp(gain, 0).confidence_interval(0.95)
    return float(found.low), float(found.high)


@given(numbers, directions)
def test_a_direction_is_judged_by_the_paired_t_test(
    sides: tuple[np.ndarray, np.ndarray], better: str
) -> None:
    gain = (sides[0] - sides[1]) * (1 if better == "higher" else -1)
    assume(np.ptp(gain) > 1e-6)
    result = verdict(*sides, better)
    low, high = interval(gain)
    assert np.allclose([result.low, result.high], [low, high], rtol=1e-9, atol=1e-9)
    assert np.isclose(result.difference, gain.mean(), atol=1e-12)
    assert np.isclose(result.visible, (high - low) / 2, rtol=1e-9, atol=1e-9)
    if min(abs(low), abs(high)) > FAR:
        significant = ttest_1samp(gain, 0).pvalue < 0.05
        expected = "holds" if gain.mean() > 0 else "contradicted here"
        assert result.words == (expected if significant else "undecided")


@given(numbers, margins)
def test_equality_is_judged_by_the_interval_in_the_margin(
    sides: tuple[np.ndarray, np.ndarray], margin: float
) -> None:
    gain = sides[0] - sides[1]
    assume(np.ptp(gain) > 1e-6)
    result = verdict(*sides, margin=margin)
    low, high = interval(gain)
    assert np.allclose([result.low, result.high], [low, high], rtol=1e-9, atol=1e-9)
    assume(min(abs(abs(low) - margin), abs(abs(high) - margin)) > FAR)
    inside = max(-low, high) < margin
    outside = low > margin or high < -margin
    words = "holds" if inside else "contradicted here" if outside else "undecided"
    assert result.words == words
    # Two one-sided tests at 2.5 % say the same.
    above = ttest_1samp(gain, -margin, alternative="greater").pvalue < 0.025
    below = ttest_1samp(gain, margin, alternative="less").pvalue < 0.025
    assert (result.words == "holds") == (above and below)


@given(numbers, margins)
def test_equality_does_not_ask_which_side_is_which(
    sides: tuple[np.ndarray, np.ndarray], margin: float
) -> None:
    result, swapped = verdict(*sides, margin=margin), verdict(*sides[::-1], margin=margin)
    assert swapped.words == result.words
    assert swapped[1:] == (-result.difference, -result.high, -result.low)


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
    assert swapped[1:] == (-result.difference, -result.high, -result.low)
    turned = {"holds": "contradicted here", "contradicted here": "holds"}
    assert swapped.words == turned.get(result.words, "undecided")


@given(numbers, directions, st.integers(-1000, 1000), st.sampled_from([0.25, 1.0, 8.0]))
def test_shift_and_unit_do_not_matter(
    sides: tuple[np.ndarray, np.ndarray], better: str, shift: int, factor: float
) -> None:
    a, b = (np.round(side * 64) / 64 for side in sides)  # so that adding is exact
    result = verdict(a, b, better)
    moved = verdict(factor * (a + shift), factor * (b + shift), better)
    assert moved.words == result.words
    assert np.allclose(moved[1:], factor * np.array(result[1:]), rtol=1e-12, atol=0)
    equal = verdict(a, b, margin=10.0)
    assert verdict(factor * (a + shift), factor * (b + shift), margin=factor * 10.0).words == (
        equal.words
    )


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
        ([2, 2.1, 1.9], [1, 1, 1], "lower", "contradicted here"),
        ([2, 0.9, 1.9], [1, 1, 1], "higher", "undecided"),
        ([2, 0.9, 1.9], [1, 1, 1], "lower", "undecided"),
        ([1, 1, 1], [2, 2, 2], "lower", "holds"),
        ([1, 1, 1], [2, 2, 2], "higher", "contradicted here"),
        ([1, 1, 1], [1, 1, 1], "lower", "undecided"),  # equal in every seed: neither side
        ([1, 2, 3], [1, 2, 3], "higher", "undecided"),
        ([0, 1, 2], [1, 1, 1], "higher", "undecided"),  # the mean is exactly 0
        ([0.1 + 0.2] * 3, [0.3] * 3, "higher", "holds"),  # equal differences are one point
        # Paired: far more spread between seeds than between the sides.
        ([1.1, 51.11, 101.1], [1, 51, 101], "higher", "holds"),
    ],
)
def test_directions(favoured: list[float], other: list[float], better: str, words: str) -> None:
    assert verdict(favoured, other, better).words == words


@pytest.mark.parametrize(
    ("gains", "margin", "words"),
    [
        ([0, 0, 0], 1e-9, "holds"),  # equal in every seed: within any margin
        ([0.5, 0.5, 0.5], 0.5, "holds"),  # the borders belong to the margin
        ([-0.5, -0.5, -0.5], 0.5, "holds"),
        ([0.5, 0.5, 0.5], 0.25, "contradicted here"),
        ([-0.5, -0.5, -0.5], 0.25, "contradicted here"),
        ([1, 2, 3], 4.5, "holds"),  # [-0.484, 4.484]
        ([1, 2, 3], 4.4, "undecided"),
        ([1, 2, 3], 0.1, "undecided"),  # as wide as to hold the margin whole
        ([2, 3, 4], 0.51, "contradicted here"),  # [0.516, 5.484]
        ([2, 3, 4], 0.52, "undecided"),
        ([-2, -3, -4], 0.51, "contradicted here"),
    ],
)
def test_margins(gains: list[float], margin: float, words: str) -> None:
    assert verdict(gains, [0] * len(gains), margin=margin).words == words


@pytest.mark.parametrize(
    ("gains", "difference", "low", "high", "words"),
    [
        # Standard deviation 1; t(2 degrees of freedom) = 4.30265; 4.30265 / sqrt(3) = 2.48414.
        ([1, 2, 3], 2, -0.48414, 4.48414, "undecided"),
        ([2, 3, 4], 3, 0.51586, 5.48414, "holds"),
        ([-3, -2, -1], -2, -4.48414, 0.48414, "undecided"),
        ([-4, -3, -2], -3, -5.48414, -0.51586, "contradicted here"),
        # Deviations -2, -1, 0, 1, 2: sqrt(10 / 4) = 1.58114; t(4) = 2.77645; times / sqrt(5).
        ([0, 1, 2, 3, 4], 2, 0.03676, 3.96324, "holds"),
        ([-1, 0, 1, 2, 3], 1, -0.96324, 2.96324, "undecided"),
    ],
)
def test_the_rule_worked_out_by_hand(
    gains: list[float], difference: float, low: float, high: float, words: str
) -> None:
    other = [10 + 7 * seed for seed in range(len(gains))]
    for better, sign in (("higher", 1), ("lower", -1)):
        favoured = [b + sign * gain for b, gain in zip(other, gains, strict=True)]
        result = verdict(favoured, other, better)
        assert result.words == words
        assert result[1:] == pytest.approx((difference, low, high), abs=5e-5)
        assert result.visible == pytest.approx((high - low) / 2, abs=5e-5)


def test_equal_differences_that_round_have_no_spread() -> None:
    result = verdict([0.1, 0.1, 0.1], [0, 0, 0], "higher")
    assert result.low == result.difference == result.high and result.visible == 0
    assert np.isclose(result.difference, 0.1, rtol=1e-15)
    assert verdict([1, 1, 1], [1, 1, 1], "lower") == Verdict("undecided", 0, 0, 0)


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
            lambda: verdict([1, 2, 3], [1, 2, 3]),
            "better: expected one of 'higher', 'lower', got None",
        ),
        (
            lambda: verdict([1, 2, 3], [1, 2, 3], "lower", 1.0),
            "better: expected None beside a margin, got 'lower'",
        ),
        (
            lambda: verdict([1, 2, 3], [1, 2, 3], margin=-1.0),
            "margin: expected a finite number above 0, got -1.0",
        ),
    ],
)
def test_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        call()
    assert str(caught.value) == message
