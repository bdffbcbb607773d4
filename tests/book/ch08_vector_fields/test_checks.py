"""Chapter 8's exercises: plausible wrong solutions are caught, other right ones are accepted."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn.functional import cosine_similarity, normalize

from book.ch08_vector_fields import checks
from posecore import rotations, symmetry
from posecore.methods.vector_field import voting
from tests.book.ch08_vector_fields import solutions_of_fields, solutions_of_poses
from tests.book.ch08_vector_fields.solutions_of_fields import count_one_by_one, cross
from tests.book.ch08_vector_fields.solutions_of_poses import overlap_one_by_one
from tests.book.exercises import ExerciseTests

seeds = st.integers(0, 2**31 - 1)


def doubles(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


class TestExercises(ExerciseTests):
    checks = checks
    solutions = (*solutions_of_fields.SOLUTIONS, *solutions_of_poses.SOLUTIONS)


@given(seeds)
def test_the_rays_meet_at_the_point_they_came_from(seed: int) -> None:
    p, q, point = 100 * doubles(3, 8, 2, seed=seed)
    lengths = doubles(2, 8, 1, seed=seed + 1).abs() + 0.1
    met = checks.intersect_rays(p, lengths[0] * (point - p), q, lengths[1] * (point - q))
    sharp = cross(normalize(point - p), normalize(point - q)).abs() < 1e-3
    assert torch.allclose(met[~sharp], point[~sharp], rtol=0, atol=1e-8)
    assert checks.intersect_rays(p, p - point, q, point - q).isnan().all()
    assert checks.intersect_rays(p, point - p, q, point - p).isnan().all()


@given(seeds)
def test_the_lines_of_rays_that_meet_cross_there_for_the_library(seed: int) -> None:
    p, u, q, v = doubles(4, 8, 2, seed=seed)
    met = checks.intersect_rays(p, u, q, v)
    meet = ~met.isnan().any(1) & (cross(normalize(u), normalize(v)).abs() > 0.01)
    lines = voting.intersect_lines(torch.stack([p, q], 1), torch.stack([u, v], 1))
    assert torch.allclose(lines[meet], met[meet], rtol=0, atol=1e-6)


@given(seeds, st.floats(0.3, 0.999))
@settings(max_examples=30)
def test_votes_are_those_of_a_loop(seed: int, threshold: float) -> None:
    pixels, vectors = 30 * doubles(2, 12, 2, seed=seed)
    points = torch.cat([pixels[:2], 30 * doubles(4, 2, seed=seed + 1)])
    counts = checks.count_inliers(pixels, vectors, points, threshold)
    assert torch.equal(counts, count_one_by_one(pixels, vectors, points, threshold))
    assert torch.equal(counts, checks.count_inliers(pixels, 3 * vectors, points, threshold))
    away = points[2:]  # on a pixel, float32 decides by chance
    theirs = voting.count_inliers(pixels, vectors[:, None], away[None], threshold)
    assert torch.equal(counts[2:], theirs[0])
    behind = checks.count_inliers(pixels, -vectors, points, threshold)
    assert (counts + behind <= 12).all()


@given(seeds)
def test_the_projection_loss_is_blind_to_reversed_vectors(seed: int) -> None:
    predicted, target = doubles(2, 9, 2, seed=seed)
    loss = checks.projection_loss(predicted, 50 * target)
    assert torch.isclose(loss, checks.projection_loss(-7 * predicted, 50 * target))
    blind = checks.blind_prediction(50 * target)
    assert checks.projection_loss(blind, 50 * target) < 1e-12
    assert (cosine_similarity(blind, target) < -1 + 1e-9).all()


@given(seeds)
def test_the_covariance_is_that_of_numpy(seed: int) -> None:
    points = 300 + 20 * doubles(9, 2, seed=seed)
    weights = torch.randint(0, 5, (9,), generator=torch.Generator().manual_seed(seed))
    weights[0] = 1
    mean, C = checks.mean_and_covariance(points, weights)
    assert np.allclose(mean, np.average(points, axis=0, weights=weights))
    assert np.allclose(C, np.cov(points.T, aweights=weights, ddof=0), atol=1e-9)
    assert (torch.linalg.eigvalsh(C) >= -1e-9).all()


@given(seeds, st.floats(-0.3, 1))
@settings(max_examples=30)
def test_the_overlap_is_that_of_a_loop(seed: int, depth: float) -> None:
    points, R = doubles(60, 3, seed=seed) / 10, rotations.random_rotations(generator=seed)
    given = points, torch.as_tensor(R).double(), torch.tensor([0.02, 0.03, depth]).double()
    K = torch.tensor([[100, 0, 19.5], [0, 100, 14.5], [0, 0, 1]]).double()
    mask = doubles(30, 40, seed=seed + 1) > 0
    share = checks.overlap(*given, K, mask)
    assert np.isclose(share, overlap_one_by_one(*given, K, mask))
    assert np.isclose(
        share + checks.overlap(*given, K, ~mask), checks.overlap(*given, K, mask | True)
    )


@given(seeds)
@settings(max_examples=30)
def test_the_canonical_pose_looks_the_same_and_is_one(seed: int) -> None:
    R = rotations.random_rotations(generator=seed, dtype=torch.float64)
    t = torch.tensor([0, 0, 1.0]).double() + doubles(3, seed=seed) / 10
    angles = doubles(5, seed=seed + 1)
    alike = R @ checks.about_z(angles)
    found = checks.canonical_rotation(alike, t.expand(5, 3))
    assert rotations.is_rotation(found).all()
    assert torch.allclose(found[:, :, 2], alike[:, :, 2])
    assert torch.allclose(found, found[:1].expand_as(found), atol=1e-6)
    # The x axis points at the camera, as far as it can: no part of the line of sight along y.
    assert torch.allclose((found.mT @ t)[:, 1], torch.zeros(5).double(), atol=1e-9)
    assert ((found.mT @ t)[:, 0] <= 0).all()


@given(seeds)
@settings(max_examples=10)
def test_the_library_has_the_same_rule_in_steps(seed: int) -> None:
    """Its favoured direction is another one, so all its answers are turned by one fixed angle."""
    R = rotations.random_rotations(6, generator=seed, dtype=torch.float64)
    t = torch.tensor([0, 0, 1.0]).double() + doubles(6, 3, seed=seed) / 10
    steps = 90
    symmetries = torch.eye(4).double().repeat(steps, 1, 1)
    symmetries[:, :3, :3] = checks.about_z(2 * torch.pi * torch.arange(steps).double() / steps)
    theirs, _ = symmetry.canonical_rotation(R, t, symmetries)
    turn = checks.canonical_rotation(R, t).mT @ theirs
    assert torch.allclose(turn, turn[:1].expand_as(turn), atol=2 * torch.pi / steps)
