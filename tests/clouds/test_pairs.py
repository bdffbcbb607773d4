"""Pairs of points by hand, in turned, moved, scaled and mirrored clouds, and where none are."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.clouds import (
    cross_product_normals,
    estimate_normals,
    neighbour_directions,
    pair_determinants,
    pair_features,
)
from posecore.nets.graph3d import other_neighbours
from posecore.rotations import random_rotations

MIRROR = torch.tensor([-1.0, 1, 1]).double()
seeds = st.integers(0, 10**6)


def cloud(seed=0, points=24, dtype=torch.float64):
    """Points, normals that are turned towards a camera, neighbours, and where the camera is."""
    generator = torch.Generator().manual_seed(seed)
    places = 0.1 * torch.randn(points, 3, generator=generator, dtype=torch.float64)
    camera = torch.nn.functional.normalize(torch.randn(3, generator=generator).double(), dim=0)
    normals = estimate_normals(places, 8, orient_to=5 * camera)
    index = other_neighbours(places[None], 5)[0]
    return places.to(dtype), normals.to(dtype), index, camera.to(dtype)


def moved(points, normals, camera, seed):
    """The same cloud, turned and moved with all that belongs to it."""
    generator = torch.Generator().manual_seed(seed)
    R = random_rotations(generator=generator, dtype=torch.float64).to(points)
    t = torch.randn(3, generator=generator).to(points)
    return points @ R.T + t, normals @ R.T, R @ camera


def angle(a, b):
    return math.acos(max(-1.0, min(1.0, float(a @ b / (a.norm() * b.norm())))))


def test_pairs_by_hand():
    points, normals, index, camera = cloud()
    found = pair_features(points, normals, index)
    lines = pair_features(points, normals, index, sign_free=True)
    signed = pair_determinants(points, normals, index, camera)
    assert found.shape == lines.shape == (24, 5, 3)
    assert signed.shape == (24, 5, 2)
    for i in range(24):
        for k, j in enumerate(index[i].tolist()):
            way = points[j] - points[i]
            expected = [float(way.norm()), angle(normals[i], way), angle(normals[j], way)]
            assert found[i, k].tolist() == pytest.approx(expected)
            expected[1:] = [min(a, math.pi - a) for a in expected[1:]]
            assert lines[i, k].tolist() == pytest.approx(expected)
            u = way / way.norm()
            volumes = [torch.stack([normals[i], u, v]).det() for v in (normals[j], camera)]
            assert signed[i, k].tolist() == pytest.approx([float(v) for v in volumes])
    assert torch.equal(pair_determinants(points, normals, index), signed[..., :1])


@given(seed=seeds)
def test_a_turn_and_a_move_change_nothing(seed):
    points, normals, index, camera = cloud(seed)
    others, turned, seen = moved(points, normals, camera, seed)
    for sign_free in (False, True):
        torch.testing.assert_close(
            pair_features(others, turned, index, sign_free),
            pair_features(points, normals, index, sign_free),
            rtol=1e-9, atol=1e-9,
        )  # fmt: skip
    torch.testing.assert_close(
        pair_determinants(others, turned, index, seen),
        pair_determinants(points, normals, index, camera),
        rtol=1e-9, atol=1e-9,
    )  # fmt: skip


def test_to_the_precision_of_float32():
    points, normals, index, camera = cloud(dtype=torch.float32)
    R = random_rotations(generator=torch.Generator().manual_seed(1)).float()
    for one, other in (
        (pair_features(points @ R.T, normals @ R.T, index), pair_features(points, normals, index)),
        (
            pair_determinants(points @ R.T, normals @ R.T, index, R @ camera),
            pair_determinants(points, normals, index, camera),
        ),
    ):
        torch.testing.assert_close(one, other, rtol=0, atol=3e-6)


@given(seed=seeds, scale=st.floats(0.01, 100))
def test_angles_are_those_of_a_scaled_cloud_and_distances_are_scaled(seed, scale):
    points, normals, index, camera = cloud(seed)
    found = pair_features(scale * points, normals, index)
    known = pair_features(points, normals, index)
    known[..., 0] *= scale
    torch.testing.assert_close(found, known)
    torch.testing.assert_close(
        pair_determinants(scale * points, normals, index, camera),
        pair_determinants(points, normals, index, camera),
    )


@given(seed=seeds)
def test_distances_and_angles_cannot_tell_a_mirror_image(seed):
    """To the bit: the mirror changes the sign of one coordinate, and no rounding."""
    points, normals, index, camera = cloud(seed)
    mirrored, others, seen = (x * MIRROR for x in (points, normals, camera))
    for sign_free in (False, True):
        one = pair_features(points, normals, index, sign_free)
        assert torch.equal(pair_features(mirrored, others, index, sign_free), one)
    one = pair_determinants(points, normals, index, camera)
    torch.testing.assert_close(pair_determinants(mirrored, others, index, seen), -one)
    assert (one.abs().amax((0, 1)) > 0.1).all()  # and they are not all zero


def test_normals_with_the_other_sign():
    points, normals, index, camera = cloud()
    signs = torch.tensor([1.0, -1]).double().repeat(12)[:, None]
    coin = normals * signs
    assert torch.equal(
        pair_features(points, coin, index, sign_free=True),
        pair_features(points, normals, index, sign_free=True),
    )
    printed = pair_features(points, coin, index)[..., 1:]
    assert not torch.allclose(printed, pair_features(points, normals, index)[..., 1:])
    flipped = pair_determinants(points, coin, index, camera)[..., 1]
    torch.testing.assert_close(
        flipped, pair_determinants(points, normals, index, camera)[..., 1] * signs
    )


def test_normals_as_printed_are_as_the_order_of_two_points():
    points, _, index, _ = cloud()
    found = cross_product_normals(points, index)
    for i in range(24):
        a, b = (points[j] - points[i] for j in index[i, :2])
        expected = torch.linalg.cross(a, b)
        torch.testing.assert_close(found[i], expected / expected.norm())
    torch.testing.assert_close(cross_product_normals(points, index[:, [1, 0]]), -found)
    R = random_rotations(generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    torch.testing.assert_close(cross_product_normals(points @ R.T, index), found @ R.T)


def test_copies_and_lines():
    """No direction: the angle is a right one, the determinant and the normal are zero."""
    points = torch.tensor([[0.0, 0, 0], [0, 0, 0], [1, 0, 0], [3, 0, 0]]).double()
    normals = torch.tensor([[0.0, 0, 1], [0, 0, 1], [0, 0, 0], [1, 0, 0]]).double()
    index = torch.tensor([[1, 2], [0, 2], [0, 3], [2, 0]])
    found = pair_features(points, normals, index)
    right = math.pi / 2
    assert found[0].tolist() == [[0, right, right], [1, right, right]]
    assert found[2].tolist() == [[1, right, right], [2, right, 0]]
    assert found[3].tolist() == [[2, math.pi, right], [3, math.pi, right]]
    assert pair_features(points, normals, index, sign_free=True)[3, 0].tolist() == [2, 0, right]
    assert not pair_determinants(points, normals, index).any()
    assert not cross_product_normals(points, index).any()
    turned = (
        points @ random_rotations(generator=torch.Generator().manual_seed(1), dtype=torch.float64).T
    )
    assert not cross_product_normals(turned, index).any()


def test_directions_have_length_one_or_none():
    points = cloud()[0]
    points[1] = points[0]
    index = other_neighbours(points[None], 5)[0]
    found = neighbour_directions(points, index)
    way = points[index] - points[:, None]
    length = way.norm(dim=-1, keepdim=True)
    torch.testing.assert_close(found, torch.where(length > 0, way / length, 0.0))
    assert (found.norm(dim=-1) == 0).nonzero().tolist() == [[0, 0], [1, 0]]
    tiny = neighbour_directions((1e-30 * points).float(), index).norm(dim=-1)
    torch.testing.assert_close(tiny, (length[..., 0] > 0).float())


def test_gradients():
    points, normals, index, camera = cloud(points=9)
    inputs = [x.clone().requires_grad_() for x in (points, normals, camera)]
    assert torch.autograd.gradcheck(
        lambda p, n, v: (
            neighbour_directions(p, index),
            pair_features(p, n, index),
            pair_determinants(p, n, index, v),
            cross_product_normals(p, index),
        ),
        inputs,
    )
    copies = torch.zeros(4, 3, requires_grad=True)
    some = torch.tensor([[1, 2], [0, 2], [0, 3], [2, 0]])
    found = pair_features(copies, torch.ones(4, 3), some).sum()
    (found + neighbour_directions(copies, some).sum()).backward()
    assert copies.grad.isfinite().all()


def test_indices_that_cannot_be():
    points, normals, index, _ = cloud()
    for call in (
        lambda i: neighbour_directions(points, i), lambda i: pair_features(points, normals, i),
        lambda i: pair_determinants(points, normals, i), lambda i: cross_product_normals(points, i),
    ):  # fmt: skip
        for wrong in (index[:-1], index[0], index[None]):
            with pytest.raises(ValueError, match=r"^indices: expected shape \(24, K\)"):
                call(wrong)
        with pytest.raises(ValueError, match="^indices: expected integers from 0 to 23"):
            call(np.full((24, 2), 24))
    with pytest.raises(ValueError, match="^indices: expected two neighbours"):
        cross_product_normals(points, index[:, :1])
