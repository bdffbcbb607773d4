"""Faces of a box: where points see them, and what they vote for."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.methods.invariant_gcn.faces import (
    FACES,
    face_distances,
    face_points,
    outward_normals,
    voted_faces,
)
from posecore.metrics import box_corners
from posecore.rotations import random_rotations

SEEDS = st.integers(0, 10**6)


def box(seed, count=20):
    rng = np.random.default_rng(seed)
    R, t, size = random_rotations(generator=rng), rng.normal(size=3), rng.uniform(0.1, 1, 3)
    points = (rng.uniform(-0.5, 0.5, (count, 3)) * size) @ R.T + t
    return points, R, t, size


@given(seed=SEEDS)
def test_corners_lie_on_three_faces_each(seed):
    _, R, t, size = box(seed)
    distances = face_distances(box_corners(R, t, size), R, t, size)
    assert (np.abs(distances) < 1e-9).sum(1).tolist() == [3] * 8
    np.testing.assert_allclose(np.abs(distances).sum(1), size.sum())
    for i, name in enumerate(FACES):
        axis, sign = R[:, "xyz".index(name[0])], 1 if name[1] == "+" else -1
        np.testing.assert_allclose(outward_normals(R)[i], sign * axis)
        middle = t + sign * axis * size["xyz".index(name[0])] / 2
        assert abs(face_distances(middle[None], R, t, size)[0, i]) < 1e-9


@given(seed=SEEDS)
def test_true_votes_give_the_faces(seed):
    points, R, t, size = box(seed)
    rng = np.random.default_rng(seed)
    distances = face_distances(points, R, t, size)
    assert (distances > 0).all()
    normals = np.broadcast_to(outward_normals(R), (20, 6, 3))
    votes = face_points(points, normals, distances)
    ahead = ((votes - t) * outward_normals(R)).sum(-1)
    np.testing.assert_allclose(ahead, np.broadcast_to(np.tile(size / 2, 2), (20, 6)), atol=1e-9)
    planes = voted_faces(points, normals, distances, rng.uniform(0.1, 1, (20, 6)))
    np.testing.assert_allclose(planes.normal, outward_normals(R), atol=1e-6)
    np.testing.assert_allclose(
        planes.offset, outward_normals(R) @ t + np.tile(size / 2, 2), atol=1e-6
    )


def test_points_that_are_not_sure_do_not_count():
    points, R, t, size = box(1)
    normals = np.broadcast_to(outward_normals(R), (20, 6, 3)).copy()
    distances, sure = face_distances(points, R, t, size), np.ones((20, 6))
    distances[:5] += 3
    sure[:5] = 0
    planes = voted_faces(points, normals, distances, sure)
    np.testing.assert_allclose(planes.normal, outward_normals(R), atol=1e-6)
    assert (
        np.abs(voted_faces(points, normals, distances, sure + 1).normal - planes.normal).max() > 0.1
    )


def test_gradients_reach_all_that_votes():
    points, R, t, size = (torch.from_numpy(np.asarray(x)) for x in box(2))
    generator = torch.Generator().manual_seed(0)
    normals = outward_normals(R) + 0.1 * torch.randn(20, 6, 3, generator=generator).double()
    distances, sure = face_distances(points, R, t, size), torch.rand(20, 6, generator=generator)
    inputs = [x.requires_grad_() for x in (normals, distances, sure.double())]
    assert torch.autograd.gradcheck(lambda n, d, c: voted_faces(points, n, d, c), inputs)


def test_confidences_that_cannot_be():
    points, R, t, size = box(1)
    normals, distances = np.ones((20, 6, 3)), face_distances(points, R, t, size)
    for sure in (-np.ones((20, 6)), np.eye(20, 6) * [1, 1, 1, 1, 1, 0]):
        with pytest.raises(ValueError, match="^confidences: expected none negative, some above 0"):
            voted_faces(points, normals, distances, sure)
