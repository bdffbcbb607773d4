"""Chapter 2's figures of the rasteriser say in words what they show, and its scene is sound."""

import re
from itertools import combinations

import numpy as np
import pytest

from book.ch02_small_worlds.drawing import grids
from book.ch02_small_worlds.drawing import rasteriser as draw
from data_tools import renderer
from posecore import cameras, poses

pytestmark = pytest.mark.slow

CORNERS = np.array([[1.0, 7], [10, 4], [4, 1]])
SIZE = 12, 9


def centres():
    return np.stack(np.meshgrid(np.arange(12), np.arange(9)), -1)


def inside(values):
    return (values > 0).all(-1)


def test_edge_functions_are_positive_where_the_library_draws(rng):
    for _ in range(50):
        corners = rng.uniform([0, 0], [11, 8], (3, 2))
        values = grids.edges(corners, centres())
        a, b = corners[1] - corners[0], corners[2] - corners[0]
        signed_area = -(a[0] * b[1] - a[1] * b[0])  # y points down
        np.testing.assert_allclose(values.sum(-1), signed_area, atol=1e-12)
        mesh = draw.mesh_of(np.column_stack([corners, np.ones(3)]), [[0, 1, 2]])
        pose = np.eye(3), np.zeros(3)
        labels = renderer.render_labels([renderer.prepare(mesh)], [pose], np.eye(3), SIZE)
        sign = np.sign(signed_area)  # the mesh is open: seen from both sides
        np.testing.assert_array_equal(inside(sign * values), labels.face == 0)
        solid = draw.mesh_of(mesh.vertices, mesh.faces, closed=True)
        labels = renderer.render_labels([renderer.prepare(solid)], [pose], np.eye(3), SIZE)
        np.testing.assert_array_equal(inside(values), labels.face == 0)


def test_the_objects_stand_on_the_floor_apart_and_in_the_picture():
    scene = draw.still_life()
    R_floor, t_floor = scene.poses[3]
    footprints = []
    for mesh, (R, t) in zip(scene.meshes[:3], scene.poses[:3], strict=True):
        seen = poses.apply(R, t, mesh.vertices)
        on_floor = poses.apply(*poses.invert(R_floor, t_floor), seen)
        assert on_floor[:, 2].min() == pytest.approx(0, abs=1e-12)
        pixels = cameras.project(scene.K, seen)
        assert (pixels > 0).all() and (pixels < np.array(scene.size) - 1).all()
        footprints.append(on_floor[:, :2])
    angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)])
    for one, other in combinations(footprints, 2):  # some straight line runs between the two
        assert ((one @ directions).max(0) < (other @ directions).min(0)).any()


def test_the_long_lens_is_the_same_camera():
    scene = draw.still_life()
    objects = [renderer.prepare(scene.meshes[0])]
    head = renderer.render_labels(objects, scene.poses[:1], scene.close_K, scene.size)
    assert 0.4 < (head.instance == 0).mean() < 0.8
    assert scene.close_K[0, 0] == scene.close_K[1, 1] > 3 * scene.K[0, 0]


def test_clay_and_matt_objects_keep_their_shape():
    mesh = draw.still_life().meshes[0]
    for changed in (draw.of_clay(mesh), draw.matt(mesh)):
        assert changed.vertices is mesh.vertices and changed.faces is mesh.faces
        assert all(material.specular == 0 for material in changed.materials)
    assert len({material.colour for material in draw.of_clay(mesh).materials}) == 1
    paints = [material.colour for material in mesh.materials]
    assert [material.colour for material in draw.matt(mesh).materials] == paints


def test_tiles_cover_a_square_and_face_up():
    floor = draw.tiles(6.0, 8)
    a, b, c = np.moveaxis(floor.vertices[floor.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    assert len(floor.faces) == 128
    np.testing.assert_allclose(normals, [[0, 0, 0.75**2]] * 128, atol=1e-12)
    np.testing.assert_allclose(floor.bounds, [[-3, -3, 0], [3, 3, 0]])


@pytest.mark.parametrize("k", range(3))
def test_half_planes_show_the_numbers_of_their_edge(k):
    values = grids.edges(CORNERS, centres())
    figure = draw.half_planes(CORNERS, values, inside(values))
    order = (2, 0, 1)  # of the panels
    texts = [text.get_text() for text in figure.axes[order.index(k)].texts]
    shown = [int(t.replace("\N{MINUS SIGN}", "-")) for t in texts if t and not t.isalpha()]
    assert shown == values[..., k].ravel().astype(int).tolist()
    assert f"{inside(values).sum()} pixels" in figure.alt


def numbers(title):
    return [int(n.replace("\N{MINUS SIGN}", "-")) for n in re.findall("\N{MINUS SIGN}?\\d+", title)]


CASES = {
    "inside": (6, 3, 4, 1),
    "on an edge": (7, 5, 4, 1),
    "outside": (10, 1, 4, 1),
    "seen from behind: not drawn": (6, 6, 8, 8),
    "the triangle has no area": (6, 3, 4, 6),
}


@pytest.mark.parametrize("where", CASES)
def test_the_slider_says_where_the_pixel_is(where):
    x, y, c_x, c_y = CASES[where]
    figure = draw.edge_functions(x, y, c_x, c_y)
    title = figure.get_suptitle()
    assert title.endswith(where) and where in figure.alt
    assert numbers(title)[:2] == [x, y]
    *values, total = numbers(title)[2:]
    expected = grids.edges(np.array([[1.0, 7], [10, 4], [c_x, c_y]]), np.array([x, y], float))
    assert values == expected.tolist() and total == sum(values)
    bars = figure.axes[1].patches
    if total:
        assert [bar.get_width() for bar in bars] == pytest.approx(expected / total)


@pytest.mark.parametrize("corner", [(0, 0), (11, 8), (1, 7), (10, 4), (0, 8)])
def test_the_slider_works_in_its_whole_range(corner):
    assert len(draw.edge_functions(11, 0, *corner).png(dpi=50)) > 2000


def test_the_middle_of_the_image_sees_the_harmonic_mean():
    alt = draw.wall_from_above().alt
    assert f"a depth of {2 / (1 / 1.0 + 1 / 3.2):.2f} m" in alt
    assert f"middle is at {(1.0 + 3.2) / 2:.2f} m" in alt


def depth_pair():
    beta = grids.edges(CORNERS, centres()) / 45
    z = np.array([1.0, 2, 4])
    with np.errstate(divide="ignore"):
        return draw.two_depths(CORNERS, beta @ z, 1 / (beta @ (1 / z)), inside(beta))


def masks():
    full = np.zeros((2, 20, 30), bool)
    full[0, 4:12, 5:15], full[1, 6:16, 10:25] = True, True
    visible = full.copy()
    visible[1] &= ~full[0]
    return draw.masks(full, visible, ["near", "far"])


def knows():
    scene = draw.still_life()
    mesh, pose = scene.meshes[0], scene.poses[0]
    labels = renderer.render_labels([renderer.prepare(mesh)], [pose], scene.K, scene.size)
    depth = np.where(labels.depth > 0, labels.depth, np.inf)
    return draw.what_a_pixel_knows(depth, labels.face, labels.coordinates, mesh)


SLOPE = np.linspace(0.5, 2, 300).reshape(15, 20)
FIGURES = {
    "edge_functions": draw.edge_functions,
    "landed": lambda: draw.landed(CORNERS, np.array([1.0, 2, 4]), SIZE),
    "shared_edge": lambda: draw.shared_edge(
        [*CORNERS, np.array([11.0, 0])],
        np.stack([inside(grids.edges(CORNERS, centres()))] * 2)
        & np.array([True, False])[:, None, None],
        (grids.edges(CORNERS, centres()) == 0).any(-1),
    ),
    "barycentric": lambda: draw.barycentric(CORNERS, SIZE),
    "wall": draw.wall_from_above,
    "two_depths": depth_pair,
    "chessboards": lambda: draw.chessboards({"one": np.stack([SLOPE] * 3, -1)}),
    "in_front": lambda: draw.who_is_in_front([np.eye(8, dtype=int) - 1], ["z-buffer"]),
    "knows": knows,
    "masks": masks,
    "beam": draw.spread_beam,
    "flat": lambda: draw.flat_and_smooth({"flat": SLOPE, "smooth": SLOPE}, SLOPE > 1),
    "cut": lambda: draw.cut_or_not(np.where(SLOPE < 0.7, np.inf, SLOPE), SLOPE),
    "added": lambda: draw.what_is_added(
        {str(k): np.stack([SLOPE] * 3, -1) for k in range(5)}, np.zeros((15, 20, 3), np.uint8), 1.0
    ),
}


@pytest.mark.parametrize("name", FIGURES)
def test_figures_have_words_and_repeat_byte_for_byte(name):
    first, second = FIGURES[name](), FIGURES[name]()
    assert len(first.alt) > 60 and first.alt == second.alt
    assert first.png(dpi=50) == second.png(dpi=50)


def test_titles_of_masks_say_what_is_visible():
    assert [axes.get_title() for axes in masks().axes] == [
        "near: 100 % visible",
        "far: 80 % visible",
    ]
