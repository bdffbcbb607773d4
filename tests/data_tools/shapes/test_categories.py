from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from data_tools.shapes import CATEGORIES, make_category
from data_tools.shapes.building import turns

make = cache(make_category)
seeds = st.integers(0, 2**31)
# Smallest and largest extent along x, y (up) and z (front), metres.
SIZES = {
    "bottle": ((0.03, 0.15, 0.03), (0.12, 0.29, 0.12)),
    "bowl": ((0.10, 0.02, 0.10), (0.21, 0.10, 0.21)),
    "camera": ((0.09, 0.06, 0.04), (0.16, 0.12, 0.13)),
    "can": ((0.05, 0.03, 0.05), (0.10, 0.16, 0.10)),
    "laptop": ((0.25, 0.12, 0.15), (0.37, 0.29, 0.42)),
    "mug": ((0.08, 0.07, 0.06), (0.16, 0.13, 0.12)),
}


def test_names():
    assert CATEGORIES == ("bottle", "bowl", "camera", "can", "laptop", "mug")


@settings(deadline=None, max_examples=8)
@given(seeds)
@pytest.mark.parametrize("category", CATEGORIES)
def test_any_seed_makes_a_sound_instance_of_its_size(category, seed):
    mesh = make_category(category, seed)
    low, high = SIZES[category]
    assert (mesh.size >= low).all() and (mesh.size <= high).all()
    np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-9)
    assert mesh.closed.all()
    assert 2_000 <= len(mesh.faces) <= 6_000


@pytest.mark.parametrize("category", CATEGORIES)
def test_instances_differ_in_shape(category):
    for one, two in combinations(range(6), 2):
        a, b = make(category, one), make(category, two)
        # Not merely scaled: compared at equal diameter.
        gap = cKDTree(a.vertices / a.diameter).query(b.vertices / b.diameter)[0]
        assert gap.max() > 0.005, (one, two)
        assert not np.allclose(a.size, b.size, atol=5e-4)
        assert a.materials != b.materials


@pytest.mark.parametrize("category", CATEGORIES)
def test_symmetries(category):
    mesh = make(category, 4)
    if category in ("camera", "laptop", "mug"):
        assert len(mesh.symmetries) == 1 and mesh.axis is None
        return
    np.testing.assert_array_equal(mesh.axis, [0, 1, 0])
    np.testing.assert_array_equal(mesh.symmetries, turns((0, 1, 0), 36))
    tree = cKDTree(mesh.vertices)
    for motion in mesh.symmetries:
        assert tree.query(mesh.vertices @ motion[:3, :3].T)[0].max() < 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_canonical_frames(seed):
    mug = make("mug", seed)
    axis = mug.bounds[0, 0] + mug.size[2] / 2  # of the body, which the handle moves off the origin
    radius = np.hypot(mug.vertices[:, 0] - axis, mug.vertices[:, 2])
    assert mug.vertices[radius.argmax(), 0] > axis  # the handle is the farthest out, along +x
    assert abs(mug.vertices[radius.argmax(), 2]) < 0.012
    assert abs(mug.bounds[:, 2].sum()) < 1e-9

    camera = make("camera", seed)
    glass = next(i for i, m in enumerate(camera.materials) if m.shininess == 120)
    rear, front = (f(camera.vertices[:, 2]) for f in (np.min, np.max))
    pane = camera.vertices[camera.faces[camera.material == glass]].reshape(-1, 3)
    assert pane[:, 2].max() > rear + 0.8 * (front - rear)  # the lens looks along +z

    laptop, middles = make("laptop", seed), {}
    for pattern, axis in (("screen", 2), ("keyboard", 1)):
        index = next(i for i, m in enumerate(laptop.materials) if m.pattern == pattern)
        rows = laptop.material == index
        a, b, c = np.moveaxis(laptop.vertices[laptop.faces[rows]], 1, 0)
        normal = np.cross(b - a, c - a)
        large = np.linalg.norm(normal, axis=1) > 0.001
        assert normal[large][:, axis].max() > 0
        middles[pattern] = laptop.vertices[laptop.faces[rows]].reshape(-1, 3).mean(0)
    rise, towards_us = (middles["screen"] - middles["keyboard"])[1:]
    assert rise > 0.05 and towards_us < -0.05

    for category in ("bottle", "can", "bowl"):
        mesh = make(category, seed)
        wide = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 2])
        upper, lower = (wide[s * mesh.vertices[:, 1] > 0.4 * mesh.size[1]].max() for s in (1, -1))
        assert {"bottle": upper < 0.6 * lower, "can": True, "bowl": upper > lower}[category]


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: make_category("cup", 0), "category"),
        (lambda: make_category("", 0), "category"),
        (lambda: make_category(3, 0), "category"),
        (lambda: make_category("mug", -1), "seed"),
        (lambda: make_category("mug", 1.5), "seed"),
        (lambda: make_category("mug", None), "seed"),
        (lambda: make_category("mug", True), "seed"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}:"):
        call()
