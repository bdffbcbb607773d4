"""The figures of chapter 5 on what was measured show the numbers that they were given."""

import numpy as np
import pytest

from book.ch05_learnable_rotations.drawing import results as page
from book.tools.keys import Key
from posecore import cameras, rotations

pytestmark = pytest.mark.slow

FOUR = ("quaternion, chordal", "6d, chordal", "procrustes, chordal", "learnable, output")


def mean(method, split=""):
    return Key(method, split, "rotation")


def test_tails_are_the_shares_above_and_end_at_the_worst():
    errors = {"6d": np.linspace(0.01, 2, 4000), "quaternion": np.geomspace(0.1, 170, 4000)}
    figure = page.tails(errors)
    axes = figure.axes[0]
    curves = [line for line in axes.lines if len(line.get_xdata()) > 1]
    for line, gap in zip(curves, errors.values(), strict=True):
        x, share = line.get_data()
        assert len(x) < 250 and x[-1] == gap.max() and np.isclose(share[-1], 1 / len(gap))
        for value, part in zip(x, share, strict=True):
            assert np.isclose((gap >= value).mean(), part)
    assert "quaternion 170°" in figure.alt and axes.get_xscale() == axes.get_yscale() == "log"


def test_table_iv_shows_every_seed_and_the_papers_numbers():
    numbers = {
        mean("6d"): np.array([0.5, 0.6, 0.7]),
        Key("6d", metric="rotation largest"): np.array([1.5, 1.6, 1.7]),
        mean("euler"): np.array([3.0, 3.5, 4.0]),
        Key("euler", metric="rotation largest"): np.array([170.0, 175, 178]),
        Key("6d", metric="rotation smallest"): np.zeros(3),
    }
    figure = page.table_iv(numbers)
    axes = figure.axes[0]
    drawn = {line.get_label(): line for line in axes.lines}
    for label, places in (("mean", (-0.12, 0.88)), ("largest", (0.12, 1.12))):
        values = [
            v for key, v in numbers.items() if (key.metric == "rotation") == (label == "mean")
        ]
        assert np.array_equal(drawn[label].get_ydata(), np.concatenate(values[:2]))
        assert np.allclose(drawn[label].get_xdata(), np.repeat(places, 3), atol=0.051)
    crosses = drawn["the paper's"]
    assert crosses.get_marker() == "x"
    assert np.allclose(crosses.get_data(), [[-0.12, 0.12], [0.49, 1.78]])  # it has no Euler angles
    assert [label.get_text() for label in axes.get_xticklabels()] == ["6d", "euler"]
    assert "6d 0.60° and 1.6°" in figure.alt


@pytest.mark.parametrize(
    "figure",
    [
        page.table_iv({}),
        page.seen({"image": {}, "points": {}}, FOUR),
        page.crossed({"told R": {}}, {}),
    ],
)
def test_what_is_not_measured_yet_is_said(figure):
    assert "ot measured yet" in figure.alt and len(figure.png()) > 1000


def test_all_teapots_are_in_the_picture_and_differ():
    places = np.array([[x, 0.0, 0.75] for x in (-0.62, 0.0, 0.62)])
    R = rotations.euler_to_matrix(np.radians([0.0, 110.0, 40.0]))
    figure = page.same_rotation(R, places)
    image = np.asarray(figure.axes[0].images[0].get_array()).astype(int)
    parts = []
    for u, v in cameras.project(page.SAME_K, places).round().astype(int):
        parts.append(image[v - 40 : v + 40, u - 55 : u + 55])
        assert parts[-1].shape == (80, 110, 3) and parts[-1].std() > 20
    assert np.abs(parts[0] - parts[2]).mean() > 5
    degrees = [text.get_text() for text in figure.axes[0].texts]
    assert degrees[0] == degrees[2] == "ray 40° off the axis" and "ray 0°" in degrees[1]


def test_axes_on_looks_turn_with_the_answer():
    images = np.zeros((3, 20, 20, 3))
    R = rotations.random_rotations(3, generator=0).numpy()
    figure = page.looks(images, R, columns=2)
    assert len(figure.axes) == 4 and not figure.axes[3].lines
    for axes, turned in zip(figure.axes, R, strict=False):
        ends = np.array([np.diff(line.get_xydata(), axis=0)[0] for line in axes.lines])
        assert np.allclose(ends, 8.4 * turned[:2].T)


def test_seen_has_a_mark_for_each_seed_and_split():
    table = {mean(name, split): np.array([10.0, 12, 14]) + 5 * k
             for k, name in enumerate(FOUR) for split in ("easy", "occluded")}  # fmt: skip
    figure = page.seen({"image": table, "points": {}}, FOUR)
    lines = [line.get_ydata().tolist() for line in figure.axes[0].lines]
    assert lines == [table[mean(name, split)].tolist() for name in FOUR
                     for split in ("easy", "occluded")]  # fmt: skip
    assert all(len(line.get_ydata()) == 0 for line in figure.axes[1].lines)
    assert "from its image, learnable, output 27° and 27°" in figure.alt


def test_crossed_tables_have_means_in_their_places():
    table = {mean(f"{name}, {loss}"): np.array([1.0, 2.0, 3.0]) * (1 + i) + j
             for i, name in enumerate(("quaternion", "6d", "procrustes"))
             for j, loss in enumerate(("output", "chordal", "geodesic"))}  # fmt: skip
    table[mean("learnable, output")] = np.array([0.5, 0.5, 0.5])
    seen = {mean(key.method, "easy"): 10 * values for key, values in table.items()}
    seen[mean("6d, chordal", "occluded")] = np.zeros(3)  # of another split
    seen[Key("6d, chordal", "easy", "rotation median")] = np.zeros(3)  # and another metric
    figure = page.crossed({"told R": table, "image": seen}, {"image": "easy"})
    shown = figure.axes[0].images[0].get_array()
    assert np.allclose(shown[:3], [[2, 3, 4], [4, 5, 6], [6, 7, 8]]) and shown[3, 0] == 0.5
    assert np.allclose(figure.axes[1].images[0].get_array()[:3], 10 * shown[:3])
    assert np.isnan(np.ma.filled(shown, np.nan)[3, 1:]).all()
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert "2.00\n± 1.00" in texts and texts.count("as\nprocrustes") == 2
    assert "told R: least for learnable, output, 0.5°, and most for procrustes" in figure.alt
