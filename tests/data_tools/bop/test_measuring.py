"""Own meshes: what is measured, and symmetries that are true, nearly true and false."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from data_tools.bop import Symmetry, measure_model

BOX = trimesh.creation.box((0.10, 0.06, 0.04))
SQUARE = trimesh.creation.box((0.06, 0.06, 0.04))
CUBE = trimesh.creation.box((0.06, 0.06, 0.06))
CAN = trimesh.creation.cylinder(0.04, 0.1, sections=64)
seeds = st.integers(0, 10**6)


def stated(*texts):
    return [Symmetry.parse(text) for text in texts]


def is_group(motions):
    """Whether all products are among them, to rounding."""
    products = (motions[:, None] @ motions).reshape(-1, 4, 4)
    return all(np.abs(motions - T).max((1, 2)).min() < 1e-9 for T in products)


# What is measured ---------------------------------------------------------------------------------


@given(seeds)
def test_diameter_and_box_are_those_of_the_vertices(seed):
    points = np.random.default_rng(seed).normal(size=(9, 3))
    info = measure_model(trimesh.Trimesh(points, [[0, 1, 2]], process=False)).info
    assert info.diameter == pytest.approx(pdist(points).max(), rel=1e-15)
    assert np.array_equal(info.minimum, points.min(0))
    assert np.array_equal(info.size, points.max(0) - points.min(0))
    assert len(info.symmetries_discrete) == len(info.symmetries_continuous) == 0


def test_a_mesh_without_extent():
    with pytest.raises(ValueError, match="^mesh: expected points that differ, got 3 at one place"):
        measure_model(trimesh.Trimesh(np.ones((3, 3)), [[0, 1, 2]], process=False))


# Symmetries that there are ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "texts", "count"),
    [
        (BOX, ["x:2"], 1),
        (BOX, ["x:2", "z:2"], 3),
        (SQUARE, ["z:4"], 3),
        (SQUARE, ["z:2", "z:4"], 3),
        (SQUARE, ["z:4", "x:2"], 7),
        (SQUARE, ["z:4", "1,1,0:2"], 7),
        (CUBE, ["z:4", "x:4"], 23),
        (CUBE, ["1,1,1:3", "z:2"], 11),
        (CAN, ["z:8", "x:2"], 15),
    ],
)
def test_discrete_ones_and_what_they_make_together(mesh, texts, count):
    found = measure_model(mesh, stated(*texts), 0.01)
    assert len(found.info.symmetries_discrete) == count
    assert found.info.symmetries_continuous == ()
    assert len(found.checks) in (len(texts), len(texts) + 1)
    assert max(check.largest for check in found.checks) < 0.005
    motions = found.info.symmetries()
    assert len(motions) == count + 1 and is_group(motions)
    assert not np.signbit(found.info.symmetries_discrete[found.info.symmetries_discrete == 0]).any()


@pytest.mark.slow
def test_continuous_ones_with_a_flip():
    found = measure_model(CAN, stated("z:continuous", "x:2", "z:4", "0,0,-2:continuous"), 0.01)
    assert len(found.info.symmetries_discrete) == 1  # quarter turns are turns already
    ((axis, offset),) = found.info.symmetries_continuous
    assert axis.tolist() == [0, 0, 1] and offset.tolist() == [0, 0, 0]
    # The polygon's corners stand out by 0.04 % of the diameter; drawn points are 0.6 % apart.
    assert 0.0003 < found.checks[0].largest < 0.003


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_about_any_axis_through_any_point(seed):
    rng = np.random.default_rng(seed)
    R, t = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, 3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    mesh = SQUARE.copy().apply_transform(T)
    found = measure_model(mesh, [Symmetry(R[:, 2], 4, t + 0.3 * R[:, 2])], 0.01)
    expected = np.linalg.matrix_power(Symmetry([0, 0, 1], 4).motions()[0], 2)
    middle = T @ expected @ np.linalg.inv(T)
    np.testing.assert_allclose(found.info.symmetries_discrete[1], middle, atol=1e-12)
    with pytest.raises(ValueError, match=r"^symmetries\[0\]: expected motions that leave"):
        measure_model(mesh, [Symmetry(R[:, 2], 4, t + 0.1 * R[:, 0])])


# And those that there are not ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "text", "share"),
    [
        # A corner of the square's turned twin: half of the side times (sqrt(2) - 1) stand out.
        (SQUARE, "z:continuous", 0.03 * (np.sqrt(2) - 1) / np.sqrt(0.0088)),
        (BOX, "z:4", 0.02 / np.sqrt(0.0152)),
        (BOX, "z:2@0,10,0", 0.02 / np.sqrt(0.0152)),
    ],
)
def test_how_far_the_surface_moves(mesh, text, share):
    with pytest.raises(ValueError, match=r"^symmetries\[0\]: expected motions .*to 1 % of the"):
        measure_model(mesh, stated(text), 0.01)
    (check,) = measure_model(mesh, stated(text), 0.5).checks
    assert check.largest == pytest.approx(share, rel=0.05)
    assert 0 < check.mean < check.largest


def test_a_small_handle_is_seen():
    handle = trimesh.creation.box((0.02, 0.004, 0.01))
    handle.apply_translation([0.05, 0, 0])
    cup = trimesh.util.concatenate([CAN, handle])
    with pytest.raises(ValueError, match=r"^symmetries\[0\]: "):
        measure_model(cup, stated("z:continuous"))
    assert measure_model(cup, stated("x:2"), 0.01).checks[0].largest < 0.005


@pytest.mark.slow
def test_a_polygon_is_not_round_though_turns_by_its_sides_fit():
    prism = trimesh.creation.cylinder(0.04, 0.1, sections=6)
    assert measure_model(prism, stated("z:6"), 0.01).checks[0].largest < 0.005
    (check,) = measure_model(prism, stated("z:continuous")).checks
    expected = 0.04 * (1 - np.cos(np.pi / 6)) / np.hypot(0.08, 0.1)
    assert check.largest == pytest.approx(expected, rel=0.1)


def test_axes_that_make_no_finite_group():
    for texts in (["z:4", "0,0.3,1:4"], ["z:2", "z:2@0.001,0,0"], ["z:7", "x:5"]):
        with pytest.raises(ValueError, match="^symmetries: expected discrete symmetries that toge"):
            measure_model(CUBE, stated(*texts), 10.0)


def test_a_cloud_has_the_symmetries_of_its_points():
    corners = trimesh.Trimesh(SQUARE.vertices, np.zeros((0, 3), int), process=False)
    assert measure_model(corners, stated("z:4"), 1e-6).checks[0].largest < 1e-12
    with pytest.raises(ValueError, match=r"^symmetries\[1\]: "):
        measure_model(corners, stated("x:2", "z:3"))


# How they are stated ------------------------------------------------------------------------------


def test_parse():
    one = Symmetry.parse("0,3,4:12@1,-2e1,.5")
    assert one.axis.tolist() == [0, 0.6, 0.8] and one.fold == 12
    np.testing.assert_allclose(one.offset, [0.001, -0.02, 0.0005])
    assert Symmetry.parse("Y:Continuous@1,0,0", unit=1.0).fold is None
    assert Symmetry.parse("Y:2@1,0,0", unit=1.0).offset.tolist() == [1, 0, 0]
    assert Symmetry.parse("-1,0,0:2").axis.tolist() == [-1, 0, 0]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("z", "symmetry"),
        ("z:", "symmetry"),
        ("z:2:3", "symmetry"),
        ("z:2@0,0,0@1,1,1", "symmetry"),
        ("", "symmetry"),
        ("w:2", "axis"),
        ("0,0,0:2", "axis"),
        ("1,0:2", "axis"),
        ("nan,0,1:2", "axis"),
        ("z:1", "fold"),
        ("z:0", "fold"),
        ("z:-2", "fold"),
        ("z:2.5", "fold"),
        ("z:121", "fold"),
        ("z:infinite", "fold"),
        ("z:2@0,0", "offset"),
        ("z:2@0,0,inf", "offset"),
        ("z:2@a,b,c", "offset"),
    ],
)
def test_what_is_no_symmetry(text, name):
    with pytest.raises(ValueError, match=f"^{name}: expected "):
        Symmetry.parse(text)


@pytest.mark.parametrize("tolerance", [0, -1, np.nan, "1"])
def test_what_is_no_tolerance(tolerance):
    with pytest.raises(ValueError, match="^tolerance: expected a finite number above 0"):
        measure_model(BOX, (), tolerance)
