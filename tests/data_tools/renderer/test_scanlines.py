from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.renderer.scanlines import count_pixels, crop_rows, fill_keys, to_rows

CANVAS = (-4, -3, 16, 14)
coordinates = st.integers(-20, 72).map(lambda n: n / 4)  # exact in float64, often on a centre
corners = st.tuples(coordinates, coordinates)


def rows_of(triangles, canvas=CANVAS):
    points = np.array(triangles, np.float64).reshape(-1, 3, 2)
    return to_rows(list(points[..., 0].T), list(points[..., 1].T), canvas)


def pixels_of(rows):
    """(triangle, column, row) of every pixel, one by one."""
    return [
        (int(k), x, int(y))
        for k, y, first, last in zip(rows.triangle, rows.y, rows.first, rows.last, strict=True)
        for x in range(first, last + 1)
    ]


def slow_pixels(triangle, canvas=CANVAS):
    """The pixels of one triangle by the fill rule, in exact fractions."""
    left, top, right, bottom = canvas
    points = [(Fraction(x), Fraction(y)) for x, y in triangle]
    found = set()
    for y in range(top, bottom + 1):
        crossings = []
        for (x0, y0), (x1, y1) in zip(points, points[1:] + points[:1], strict=True):
            if min(y0, y1) <= y < max(y0, y1):  # the upper end of an edge belongs to it
                crossings.append(x0 + (y - y0) / (y1 - y0) * (x1 - x0))
        if crossings:
            found |= {
                (x, y) for x in range(left, right + 1) if min(crossings) <= x < max(crossings)
            }
    return found


@given(st.tuples(corners, corners, corners))
def test_rows_follow_the_fill_rule(triangle):
    # A crossing is rounded: a centre that an edge meets exactly may fall on either side.
    exact = slow_pixels(triangle)
    pixels = {(x, y) for _, x, y in pixels_of(rows_of([triangle]))}
    for x, y in exact ^ pixels:
        assert on_an_edge(triangle, x, y)


def on_an_edge(triangle, x, y):
    points = [(Fraction(a), Fraction(b)) for a, b in triangle]
    sides = zip(points, points[1:] + points[:1], strict=True)
    return any((q[0] - p[0]) * (y - p[1]) == (q[1] - p[1]) * (x - p[0]) for p, q in sides)


@given(st.lists(coordinates, min_size=2, max_size=6), st.tuples(corners, corners, corners, corners))
def test_neighbours_share_no_pixel_and_leave_none(cuts, quad):
    # A fan around an inner point covers exactly what one outline does.
    square = [(-2.0, -2.0), (10.0, -1.0), (11.0, 9.0), (-1.0, 10.0)]
    inner = (4 + cuts[0] / 8, 4 + cuts[1] / 8)
    fan = [(square[k], square[(k + 1) % 4], inner) for k in range(4)]
    pixels = [(x, y) for _, x, y in pixels_of(rows_of(fan))]
    assert len(pixels) == len(set(pixels))
    halves = [(square[0], square[1], square[2]), (square[0], square[2], square[3])]
    assert set(pixels) == {(x, y) for _, x, y in pixels_of(rows_of(halves))}


@given(st.integers(0, 2**32 - 1))
def test_a_fine_net_covers_every_pixel_once(seed):
    # Random heights of a net's nodes, with many nodes on centres of pixels or a hair beside them.
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-2, 10, 7), np.linspace(-2, 10, 7))
    for node in (x, y):
        inner = node[1:-1, 1:-1]
        inner += rng.choice([0, 0.3, 1e-15, -1e-15, 1e-9], inner.shape)
    nodes = np.stack([x, y], -1)
    a, b, c, d = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, 1:], nodes[1:, :-1]
    net = np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3, 2), np.stack([a, c, d], 2).reshape(-1, 3, 2)]
    )
    pixels = [(x, y) for _, x, y in pixels_of(rows_of(net))]
    assert len(pixels) == len(set(pixels))
    assert set(pixels) == {(x, y) for x in range(-2, 10) for y in range(-2, 10)}


def test_left_and_upper_edges_belong_to_a_triangle():
    pixels = {(x, y) for _, x, y in pixels_of(rows_of([((0, 0), (3, 0), (0, 3))]))}
    assert pixels == {(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)}
    pixels = {(x, y) for _, x, y in pixels_of(rows_of([((3, 3), (0, 3), (3, 0))]))}
    assert pixels == {(2, 1), (1, 2), (2, 2)}


@pytest.mark.parametrize(
    "triangle",
    [
        ((1, 1), (1, 1), (1, 1)),
        ((0, 2), (5, 2), (9, 2)),
        ((3, 0), (3, 5), (3, 9)),
        ((0, 0), (4, 4), (8, 8)),
        ((0.2, 0.2), (0.8, 0.3), (0.5, 0.9)),
        ((20, 0), (30, 5), (25, 9)),
        ((0, -9), (9, -9), (4, -5)),
    ],
    ids=["point", "flat", "upright", "line", "between centres", "beside", "above"],
)
def test_nothing_to_draw(triangle):
    assert len(rows_of([triangle]).y) == 0


def test_edges_of_no_height_do_no_harm():
    tiny = np.nextafter(2.0, 3)
    rows = rows_of([((0, 2), (5, tiny), (2, 2)), ((0, 2), (5, tiny), (2, 6))])
    pixels = {(k, x, y) for k, x, y in pixels_of(rows)}
    assert all(0 <= x <= 5 and 2 <= y <= 5 for _, x, y in pixels)
    assert (1, 2, 3) in pixels
    assert len(rows_of([((0, 0), (5, 5e-324), (2, 1e-323))]).y) <= 1
    # Far outside the canvas, where a near plane throws what it cuts.
    rows = rows_of([((-1e7, -1e7), (1e7, -1e7), (0, 1e7))])
    assert len(pixels_of(rows)) == 21 * 18


@given(st.lists(st.tuples(corners, corners, corners), min_size=1, max_size=5))
def test_each_pixel_is_counted_once(triangles):
    rows = rows_of(triangles)
    pixels = {(x, y) for _, x, y in pixels_of(rows)}
    left, top, right, bottom = CANVAS
    assert count_pixels(rows, (left, top, right - left + 1, bottom - top + 1)) == len(pixels)


@given(st.lists(st.tuples(corners, corners, corners), min_size=1, max_size=5))
def test_cropped_rows_are_those_inside(triangles):
    rows = rows_of(triangles)
    inside = [(k, x, y) for k, x, y in pixels_of(rows) if 0 <= x < 10 and 0 <= y < 7]
    assert pixels_of(crop_rows(rows, 10, 7)) == inside


@given(st.lists(st.tuples(corners, corners, corners), min_size=1, max_size=5), st.integers(0, 99))
def test_the_nearest_face_is_kept(triangles, seed):
    rng = np.random.default_rng(seed)
    rows = crop_rows(rows_of(triangles), 10, 7)
    a, b = rng.uniform(0, 0.01, (2, len(triangles)))
    c = rng.choice([1.0, 2.0, 3.0], len(triangles))
    faces = rng.permutation(16)[: len(triangles)]
    keys = fill_keys(rows, (a, b, c), faces, (0, 0, 10, 7), 4)
    best = {}
    for k, x, y in pixels_of(rows):
        candidate = a[k] * x + b[k] * y + c[k]
        if candidate > best.get((x, y), (0,))[0]:
            best[x, y] = candidate, faces[k]
    found = {(x, y) for y, x in zip(*np.nonzero(keys), strict=True)}
    assert found == set(best)
    for (x, y), (inverse_depth, face) in best.items():
        assert keys[y, x] & 15 == face
        assert keys.view(np.float64)[y, x] == pytest.approx(inverse_depth, rel=2**-47)


def test_of_two_faces_at_one_depth_the_higher_number_is_kept():
    triangle = ((0, 0), (9, 0), (0, 9))
    rows = rows_of([triangle, triangle])
    ones = np.ones(2)
    for faces in ([2, 5], [5, 2]):
        keys = fill_keys(rows, (0 * ones, 0 * ones, ones), np.array(faces), (0, 0, 9, 9), 3)
        assert set((keys[keys > 0] & 7).tolist()) == {5}
