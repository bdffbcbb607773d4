import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from data_tools.renderer.clipping import clip_near

NEAR = 0.1


def random_triangles(seed, count=8):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 3, 3))
    corners[:, :, 2] += rng.choice([-1.2, 0.0, 1.2], (count, 1))
    return rng, corners


def areas(corners):
    a, b, c = corners.swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@given(st.integers(0, 2**32 - 1))
def test_the_parts_make_up_what_is_in_front(seed):
    rng, corners = random_triangles(seed)
    parts, source = clip_near(corners, NEAR)
    assert (parts[:, :, 2] >= NEAR).all()
    # Points of a triangle are in exactly one of its parts if they are in front, in none if not.
    for k, triangle in enumerate(corners):
        points = rng.dirichlet([1, 1, 1], 50) @ triangle
        inside = sum(contains(part, points) for part in parts[source == k])
        clear = np.abs(points[:, 2] - NEAR) > 1e-9
        expected = points[:, 2] > NEAR
        assert (inside == expected)[clear].all()


def contains(triangle, points):
    """Whether points of the triangle's plane lie in the triangle."""
    a, b, c = triangle
    weights, *_ = np.linalg.lstsq(np.stack([b - a, c - a], 1), (points - a).T, rcond=None)
    return ((weights >= 0).all(0) & (weights.sum(0) <= 1)).astype(int)


@given(st.integers(0, 2**32 - 1))
def test_the_parts_keep_the_side(seed):
    _, corners = random_triangles(seed)
    parts, source = clip_near(corners, NEAR)
    whole = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[source]
    part = np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0])
    assert ((whole * part).sum(1) >= -1e-15).all()


@given(st.integers(0, 2**32 - 1))
def test_neighbours_are_cut_at_the_same_point(seed):
    rng = np.random.default_rng(seed)
    a, b = np.array([*rng.normal(size=2), 0.3]), np.array([*rng.normal(size=2), -0.2])
    c, d = (np.array([*rng.normal(size=2), rng.uniform(-1, 1)]) for _ in range(2))
    one, _ = clip_near(np.array([[a, b, c]]), NEAR)
    other, _ = clip_near(np.array([[b, a, d]]), NEAR)
    shared = {p.tobytes() for p in one.reshape(-1, 3)} & {p.tobytes() for p in other.reshape(-1, 3)}
    cut = a + (NEAR - 0.3) / (-0.2 - 0.3) * (b - a)
    assert a.tobytes() in shared
    assert any(np.allclose(np.frombuffer(p), cut, atol=1e-12) for p in shared - {a.tobytes()})


def test_known_cuts():
    one = np.array([[[0, 0, 0.2], [1, 0, 0.0], [0, 1, 0.0]]])
    parts, source = clip_near(one, NEAR)
    np.testing.assert_allclose(parts, [[[0, 0, 0.2], [0.5, 0, 0.1], [0, 0.5, 0.1]]])
    assert source.tolist() == [0]
    two = np.array([[[0, 0, 0.0], [1, 0, 0.2], [0, 1, 0.2]]])
    parts, source = clip_near(two, NEAR)
    assert source.tolist() == [0, 0]
    np.testing.assert_allclose(areas(parts).sum(), areas(two).item() * 0.75)


def test_whole_triangles_come_back_as_they_are_and_hidden_ones_not_at_all():
    front = np.array([[[0, 0, NEAR], [1, 0, 2], [0, 1, 3.0]]])
    behind = front - [0, 0, 5]
    parts, source = clip_near(np.concatenate([behind, front]), NEAR)
    assert parts.tobytes() == front.tobytes() and source.tolist() == [1]
    parts, source = clip_near(np.zeros((0, 3, 3)), NEAR)
    assert parts.shape == (0, 3, 3) and len(source) == 0
