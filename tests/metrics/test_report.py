"""The table of all metrics."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from posecore.metrics.evaluation import ObjectErrors
from posecore.metrics.report import report, summarise, to_text


def errors(add, diameter=0.2, true_angles=None, **others):
    """Errors of one object; a pose with an infinite ADD was not estimated."""
    add = np.array(add, float)
    values = {"translation": add, "add": add} | {n: np.array(v, float) for n, v in others.items()}
    return ObjectErrors(np.isfinite(add), values, true_angles or {}, None, {}, diameter)


def find(lines, section, label):
    return next(line for line in lines if line.section.startswith(section) and line.label == label)


def test_shares_of_all_and_of_the_estimated():
    """Diameter 20 cm: right below 2 cm. Two of four right, one of them missing."""
    values = summarise([errors([0.01, 0.019, 0.03, np.inf])])
    assert values["correct, % of all ground truth", "ADD < 0.1 d"] == 50
    assert values["correct, % of the estimated", "ADD < 0.1 d"] == pytest.approx(200 / 3)
    assert values["correct, number of poses", "ADD < 0.1 d"] == 2
    assert values["median of the estimated", "ADD, mm"] == pytest.approx(19)
    area = (0.9 + 0.81 + 0.7 + 0) / 4
    assert values["area under the accuracy curve to 10 cm, %", "ADD"] == pytest.approx(100 * area)


def test_objects_and_poses_weigh_differently():
    """One frequent easy object and one rare hard one: which mean a paper prints matters."""
    lines = report({1: errors([0.0] * 9), 2: errors([1.0])})
    line = find(lines, "correct, % of all", "ADD < 0.1 d")
    assert line.objects == {1: 100, 2: 0}
    assert (line.pooled, line.mean) == (90, 50)
    count = find(lines, "correct, number", "ADD < 0.1 d")
    assert (count.pooled, count.mean) == (9, None)


def test_thresholds_of_the_bop_recalls():
    """An error of 0.25 d passes the five thresholds above it, of ten."""
    one = errors([0.05], mssd=[0.05], mspd=[12.0])
    values = summarise([one])
    assert values["BOP average recall, %", "MSSD"] == pytest.approx(50)
    assert values["BOP average recall, %", "MSPD"] == pytest.approx(80)  # 15 to 50 px
    wide = summarise([one], image_width=1280)
    assert wide["BOP average recall, %", "MSPD"] == pytest.approx(90)  # 20 to 100 px


def test_angles():
    rad = np.deg2rad
    angles = {"yaw": rad([1, 1, 4]), "pitch": rad([-2, 2, 2]), "roll": rad([0, 0, 0])}
    true = {"yaw": rad([1, 2, 50]), "pitch": rad([0, 0, 0]), "roll": rad([0, 0, 0])}
    values = summarise([errors([0, 0, 0], true_angles=true, rotation=rad([2, 2, 2]), **angles)])
    section = next(s for s, label in values if label == "MAE yaw")
    assert values[section, "MAE yaw"] == pytest.approx(2)
    assert values[section, "BMAE yaw"] == pytest.approx(2.5)
    assert values[section, "RMSE yaw"] == pytest.approx(np.sqrt(6))
    assert values[section, "MAE pitch"] == pytest.approx(2)
    assert values[section, "MAE average"] == pytest.approx(4 / 3)


def test_nothing_estimated_is_zero_and_not_an_error():
    lines = report({1: errors([np.inf, np.inf])})
    assert find(lines, "correct, % of all", "ADD < 0.1 d").pooled == 0
    assert find(lines, "area", "ADD").pooled == 0
    assert not any(line.section.startswith("median") for line in lines)
    assert "nan" not in to_text(lines)


def test_text_is_aligned_and_shows_what_is_missing():
    lines = report({5: errors([0.01, np.inf]), 12: errors([0.001], mssd=[0.002])})
    text = to_text(lines)
    rows = [row for row in text.splitlines() if row.startswith("  ")]
    assert len({len(row) for row in rows}) == 1
    assert rows[0].split() == ["obj", "5", "obj", "12", "all", "mean"]
    mssd = next(row for row in rows if "MSSD, mm" in row)
    assert mssd.split()[-4:] == ["-", "2.000", "2.000*", "2.000*"]
    assert "*:" in text
    translation = next(row for row in rows if "translation, mm" in row)
    assert translation.split()[-4:] == ["10.000", "1.000", "5.500", "5.500"]


def test_an_estimate_behind_the_camera_is_an_estimate():
    """Its pixel error is infinite, and yet it counts among the estimated."""
    values = summarise([errors([0.0, 0.5, np.inf], projection=[0, np.inf, np.inf])])
    assert values["correct, % of the estimated", "2D projection < 5 px"] == 50
    assert values["median of the estimated", "2D projection, px"] == np.inf


def test_many_objects_are_printed_below_each_other():
    text = to_text(report({i: errors([i / 1000]) for i in range(1, 31)}), width=100)
    assert max(map(len, text.splitlines())) <= 100
    heads = [row.split() for row in text.splitlines() if "obj" in row and ":" not in row]
    names = [name for row in heads for name in row if name != "obj"]
    assert names == [*map(str, range(1, 31)), "all", "mean"]


@given(st.lists(st.floats(0, 0.3), min_size=1, max_size=9), st.integers(0, 8))
def test_the_order_of_the_poses_does_not_matter(add, turn):
    turned = add[turn % len(add) :] + add[: turn % len(add)]
    one, other = summarise([errors(add)]), summarise([errors(turned)])
    assert one == pytest.approx(other)
    together = summarise([errors(add[:1]), errors(add[1:] or add[:1])])
    if len(add) > 1:
        assert together == pytest.approx(one)


@given(
    st.dictionaries(st.integers(1, 40), st.lists(st.floats(0, 9), min_size=1), min_size=1),
    st.integers(40, 200),
)
@example({1: [0.0], 2: [0.0]}, 40)  # "all" and "mean" stand in a head of their own
def test_every_value_is_printed_once_and_fits(objects, width):
    lines = report({i: errors(add) for i, add in sorted(objects.items())})
    text = to_text(lines, width)
    cells = [
        c
        for row in text.splitlines()
        if row.startswith("  ") and "obj" not in row and row.split()[0] not in ("all", "mean")
        for c in row[24:].split()
    ]
    columns = len(objects) + (2 if len(objects) > 1 else 0)
    assert len(cells) == len(lines) * columns
    assert all(len(row) <= max(width, 24 + 20) for row in text.splitlines() if row.startswith("  "))
