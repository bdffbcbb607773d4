from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_tools.shapes import GLASSES, make_glasses


def silhouette(mesh):
    """Which cells of 3 mm the front 4 cm cover, seen from the front."""
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(area), 60_000, p=area / area.sum())
    corner = rng.dirichlet((1, 1, 1), len(face))
    points = (mesh.vertices[mesh.faces[face]] * corner[..., None]).sum(1)
    front = points[points[:, 2] < 0.03]
    return {tuple(cell) for cell in np.floor(front[:, :2] / 0.003).astype(int)}


@pytest.mark.parametrize("name", GLASSES)
def test_sizes_are_those_of_glasses(name):
    low, high = make_glasses(name).bounds * 1000
    assert 150 < high[0] - low[0] < 200  # around a head
    assert 40 < high[1] - low[1] < 100
    assert high[2] > 100  # arms or band reach behind the ears
    assert -22 < low[2] < 0  # nothing stands far out
    assert low[0] < -60 and high[0] > 60


def test_lenses_lie_around_the_origin():
    """The panes of the classic glasses: their middle is the origin, and z runs backwards."""
    mesh = make_glasses("classic")
    lens = next(i for i, m in enumerate(mesh.materials) if m.infrared == 0.06)
    pane = mesh.vertices[mesh.faces[mesh.material == lens]].reshape(-1, 3)
    np.testing.assert_allclose((pane.min(0) + pane.max(0))[:2] / 2, 0, atol=1e-6)
    assert pane[:, 2].max() < 0.015
    arms = mesh.vertices[mesh.vertices[:, 2] > 0.1]
    assert len(arms) and arms[:, 1].max() > 0.02  # arms run back and then down, and y is down


@pytest.mark.parametrize("name", ["classic", "visor"])
@pytest.mark.parametrize("yaw", [0, 10, -25])
def test_lenses_mirror_a_lamp_in_a_spot(name, yaw):
    """Some of the lens, but less than a tenth, is within 5 degrees of facing the camera's lamp."""
    rng = np.random.default_rng(0)
    mesh = make_glasses(name)
    lens = mesh.material == next(i for i, m in enumerate(mesh.materials) if m.infrared == 0.06)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[lens]], 1, 0)
    lamp = Rotation.from_euler("Y", yaw, degrees=True).apply([0, 0, -1])
    seen = np.clip(np.cross(b - a, c - a) @ lamp, 0, None)
    face = rng.choice(len(seen), 50_000, p=seen / seen.sum())
    corner = rng.dirichlet((1, 1, 1), len(face))
    normals = (mesh.corner_normals[lens][face] * corner[..., None]).sum(1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert 0.005 < (normals @ lamp > np.cos(np.radians(5))).mean() < 0.1


def test_the_display_of_prism_is_before_the_right_eye():
    mesh = make_glasses("prism")
    lens = next(i for i, m in enumerate(mesh.materials) if m.infrared == 0.06)
    display = mesh.vertices[mesh.faces[mesh.material == lens]].reshape(-1, 3).mean(0)
    assert display[0] < -0.03  # x points to the wearer's left
    assert display[2] < 0


def test_models_differ_at_a_glance():
    """At 0.8 m, in an image of 320 x 188 with f = 375 px, at least 200 pixels tell two apart."""
    views = {name: silhouette(make_glasses(name)) for name in GLASSES}
    for one, two in combinations(GLASSES, 2):
        square_metres = len(views[one] ^ views[two]) * 0.003**2
        assert square_metres * (375 / 0.8) ** 2 > 200, (one, two)


@pytest.mark.parametrize(
    ("angles", "gaze"),
    [
        ((0, 0, 0), (0, 0, -1)),  # into the camera
        ((30, 0, 0), (-0.5, 0, -(0.75**0.5))),  # yaw: to the wearer's right, left in the image
        ((0, 30, 0), (0, 0.5, -(0.75**0.5))),  # pitch: down
        ((0, 0, 30), (0, 0, -1)),
    ],
)
def test_signs_of_head_angles(angles, gaze):
    R = Rotation.from_euler("YXZ", angles, degrees=True).as_matrix()
    worn = make_glasses("visor").vertices
    front, back = (worn[:, 2] < 0).nonzero()[0], (worn[:, 2] > 0.15).nonzero()[0]
    turned = worn @ R.T
    looking = turned[front].mean(0) - turned[back].mean(0)
    upright = worn[front].mean(0) - worn[back].mean(0)
    np.testing.assert_allclose(R @ [0, 0, -1], gaze, atol=1e-12)
    assert looking @ gaze == pytest.approx(upright @ [0, 0, -1])
    if angles[2]:
        assert (R @ [1, 0, 0])[1] > 0  # roll: clockwise, what is right goes down


@pytest.mark.slow
@given(st.text(max_size=8).filter(lambda name: name not in GLASSES))
def test_other_names(name):
    with pytest.raises(ValueError, match="^name:"):
        make_glasses(name)
