"""Chapter 5's figures of tears, Gram-Schmidt and Procrustes show and say what they are given."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from book.ch05_learnable_rotations.drawing import continuity as draw
from book.ch05_learnable_rotations.drawing import procrustes, turning
from posecore import rotations

pytestmark = pytest.mark.slow

THETA = np.linspace(-np.pi, np.pi, 81)


def turned(degrees, axis):
    unit = np.array(turning.AXES[axis]) / np.linalg.norm(turning.AXES[axis])
    return Rotation.from_rotvec(np.radians(degrees) * unit) * Rotation.from_matrix(turning.START)


@pytest.mark.parametrize("axis", ["slanted", "upright"])
@pytest.mark.parametrize("numbers", list(turning.NUMBERS))
def test_a_full_turn_tears_three_and_four_numbers_and_no_others(numbers, axis):
    figure = draw.once_round(200, numbers, axis)
    jumps = turning._jumps(numbers, axis)
    title = figure.axes[1].get_title()
    if numbers in ("six numbers", "nine numbers"):
        assert jumps == [] and title == f"{numbers}: no jump"
    elif numbers == "Euler angles":
        assert len(jumps) >= 1 and "a jump at" in title
    else:  # at the half turn, where w = 0
        (place,) = jumps
        w = [turned(place + step, axis).as_quat()[3] for step in (-1, 1)]
        assert w[0] * w[1] < 0 and f"a jump at {place:g}°" in title
    assert title.split(": ")[1] in figure.alt


@pytest.mark.parametrize("turn", [0, 185])
@pytest.mark.parametrize("axis", ["slanted", "upright"])
@pytest.mark.parametrize("numbers", list(turning.NUMBERS))
def test_the_slider_shows_the_numbers_of_its_turn(numbers, axis, turn):
    figure = draw.once_round(turn, numbers, axis)
    right = figure.axes[1]
    points = right.lines[-1].get_xydata()
    assert (points[:, 0] == turn).all()
    R = turned(turn, axis)
    values = {
        "Euler angles": lambda: R.as_euler("YXZ", degrees=True),
        "axis-angle vector": lambda: np.degrees(R.as_rotvec()),
        "quaternion": lambda: R.as_quat(canonical=True, scalar_first=True),
        "six numbers": lambda: R.as_matrix()[:, :2].T.ravel(),
        "nine numbers": lambda: R.as_matrix().ravel(),
    }[numbers]()
    np.testing.assert_allclose(points[:, 1], values, atol=1e-9)
    form = ".2f" if np.abs(values).max() <= 1 else ".0f"
    said = [word.split()[-1] for word in figure.alt.split("where they are ")[1].split(", ")]
    assert [float(word.rstrip(".")) for word in said] == pytest.approx(
        [float(f"{value:{form}}") for value in values], abs=1e-9
    )
    assert f"turned by {turn} degrees" in figure.alt and axis in figure.alt
    assert not set("${}\\") & set(figure.alt)
    assert figure.axes[0].get_title() == f"turned by {turn}°"


def test_the_plane_after_a_full_turn_stands_as_before():
    first, *_, last = np.split(np.array([p.get_xy() for p in draw.question().axes[0].patches]), 9)
    np.testing.assert_allclose(last, first + [360, 0], atol=1e-9)


def test_slices_fill_three_planes_of_the_ball():
    vectors = draw._vectors(12)
    np.testing.assert_allclose(
        draw.slices(12).reshape(-1, 3, 3),
        Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix(),
        atol=1e-12,
    )
    for plane, names in enumerate(draw.PLANES):
        across, up = ("xyz".index(name) for name in names)
        assert (vectors[plane, ..., 3 - across - up] == 0).all()
        assert (np.diff(vectors[plane, ..., across], axis=1) > 0).all()
        assert (np.diff(vectors[plane, ..., up], axis=0) > 0).all()
        assert np.abs(vectors[plane]).max() < np.pi


def test_a_disc_keeps_the_worst_error_and_says_so():
    low, high = np.full((3, 20, 20), 2.0), np.full((3, 20, 20), 2.0)
    high[0, 7, 12] = 170
    low[0, 0, 0] = 170  # in the corner, outside the disc
    figure = draw.discs({"low": low, "high": high})
    shown = [axes.images[0].get_array() for axes in figure.axes[:6]]
    assert [axes.get_title() for axes in figure.axes[:6]] == ["low"] * 3 + ["high"] * 3
    assert shown[0].max() == 2 and shown[3].max() == shown[3][3, 6] == 170
    assert (
        "low: none, up to 2 degrees; high: a bright band from rim to rim, up to 170" in figure.alt
    )
    one_row = draw.discs({"low": low, "high": high}, planes=1)
    assert [axes.get_title() for axes in one_row.axes[:2]] == ["low", "high"]


def test_the_circle_keeps_a_narrow_peak():
    gap = np.full(81, 0.5)
    gap[33] = 177
    figure = draw.errors_on_circle(THETA, {"torn": gap, "whole": np.full(81, 0.1)})
    torn, whole = figure.axes[0].lines
    assert torn.get_ydata().max() == 177 and whole.get_ydata().max() == pytest.approx(0.1)
    assert np.degrees(THETA[33]) == pytest.approx(
        torn.get_xdata()[torn.get_ydata().argmax()], abs=180 / 8
    )
    assert "torn 177.0, whole 0.1" in figure.alt


def test_the_torn_circle_measures_the_short_way_round():
    answer = THETA + 2 * np.pi + 0.1  # another number, almost the same hand
    figure = draw.torn_circle(THETA, answer)
    np.testing.assert_allclose(figure.axes[1].lines[0].get_ydata(), np.degrees(0.1))
    assert "up to 6 degrees" in figure.alt


def test_rings_stand_where_a_walk_passes_through_zero():
    t = np.linspace(0, 2 * np.pi, 361)
    figure = draw.walks(t, {"one": np.stack([np.cos(t / 2), np.cos(3 * t / 2)])})
    rings = [line.get_xdata() for line in figure.axes[0].lines if line.get_marker() == "o"]
    for found, expected in zip(rings, ([180], [60, 180, 300]), strict=True):
        np.testing.assert_allclose(found, expected, atol=1.01)


@pytest.mark.parametrize("flipped", [0, 1, 3])
def test_screws_are_told_apart_by_their_determinant(flipped):
    right = rotations.random_rotations(3, generator=0).numpy()
    raw = right * np.where(np.arange(3) < flipped, -1, 1)[:, None, None]
    figure = draw.screws(raw, right)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["left-handed"] * flipped + ["right-handed"] * (6 - flipped)
    assert f"{flipped} are left-handed" in figure.alt


def test_a_mirrored_screw_winds_the_other_way():
    figure = draw.screws(-np.eye(3)[None], np.eye(3)[None])
    looks = [axes.collections[0] for axes in figure.axes]
    assert len(looks[0].get_segments()) < len(looks[1].get_segments())  # its rod is dashed
    assert len(np.unique(looks[1].get_linewidths())) > 20  # near parts are thicker


def test_autograd_without_a_number_is_marked():
    distance = np.array([1e-3, 1e-2, 1e-1])
    figure = draw.autograd_fails(
        distance, {"auto": np.array([np.inf, 0.1, 0.01]), "hand": np.full(3, 1e-7)}
    )
    assert [text.get_text() for text in figure.axes[0].texts] == ["NaN"]
    assert "At 0.001: auto NaN, hand 1e-07. At 0.01: auto 0.1, hand 1e-07" in figure.alt


def test_shaken_frames_are_measured_and_the_bound_is_drawn(rng):
    angles = np.radians([[10, 0, 0], [0, 20, 0], [0, 0, 30.0]])
    frames = {"ball": rotations.axis_angle_to_matrix(angles)}
    gap = np.array([0.5, 1, 2])
    figure = draw.shaken({"ball": np.ones(3)}, frames, gap, np.full(3, 0.1), 0.01)
    assert figure.axes[0].get_title() == "ball\ns = 1, 1, 1\nturned 20°"
    assert "ball: 20 degrees" in figure.alt
    line = figure.axes[1].lines[1].get_xydata()
    np.testing.assert_allclose(line[:, 0] * line[:, 1], np.degrees(np.sqrt(2) * 0.01))


def test_an_ellipsoid_has_the_outline_of_its_shadow(rng):
    s = np.array([1.0, 0.6, -0.2])
    figure = draw.shaken({"some": s}, {"some": np.eye(3)[None]}, np.ones(2), np.ones(2), 0.1)
    outline = figure.axes[0].patches[0].get_xy()
    points = rng.normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    shadow = (points * s) @ procrustes.VIEW[:2].T
    directions = np.stack([np.cos(THETA), np.sin(THETA)])
    reach, seen = (outline @ directions).max(0), (shadow @ directions).max(0)
    assert (seen <= reach + 2e-3).all() and (seen >= reach - 2e-2).all()


def a_walk():
    t = np.linspace(0, 4 * np.pi, 81)
    return np.stack([np.cos(t / 2), 0 * t, 0 * t, np.sin(t / 2)], -1)


SIMPLE_FIGURES = {
    "question": draw.question,
    "once_round": draw.once_round,
    "torn_circle": lambda: draw.torn_circle(THETA, 0.9 * THETA),
    "two_turns": lambda: draw.two_turns(2 * THETA + 2 * np.pi, a_walk(), np.abs(a_walk())),
    "gram_schmidt": lambda: draw.gram_schmidt(np.array([[0.1, 1.3, 0], [0, 1, 1]]), np.eye(3)),
    "on_a_line": lambda: draw.on_a_line(np.arange(3), 5 - 2 * np.arange(3), (3.0, -1.0)),
    "discs": lambda: draw.discs({"net": np.ones((3, 8, 8))}),
}


@pytest.mark.parametrize("name", SIMPLE_FIGURES)
def test_figures_have_words_and_repeat_byte_for_byte(name):
    first, second = SIMPLE_FIGURES[name](), SIMPLE_FIGURES[name]()
    assert len(first.alt) > 60 and first.alt == second.alt
    assert first.png() == second.png()
