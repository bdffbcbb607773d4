"""How fast voting is beside the few lines that one would write instead, by broadcasting.

Run with `pytest -n 0 tests/bench/bench_*.py`.
"""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from posecore.methods.vector_field.voting import count_inliers, vote
from posecore.registration import pnp
from posecore.registration.weighted_pnp import uncertainty_pnp

SIZES = {"640 x 480, 10 000 pixels": (480, 640, 56.4), "320 x 240, 2500 pixels": (240, 320, 28.2)}


def disc_and_field(size: str, objects: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A disc, nine keypoints around its middle and unit vectors, 40 % of which are wrong."""
    height, width, radius = SIZES[size]
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:height, :width]
    mask = np.hypot(columns - width / 2, rows - height / 2) < radius
    keypoints = np.array([width, height]) / 2 + rng.uniform(-0.8, 0.8, (objects, 9, 2)) * radius
    x, y = np.moveaxis(keypoints[..., None, None] - np.stack([columns, rows]), 2, 0)
    angles = np.arctan2(y, x) + 0.05 * rng.normal(size=x.shape)
    wrong = rng.uniform(size=x.shape) < 0.4
    angles = np.where(wrong, rng.uniform(-np.pi, np.pi, x.shape), angles)
    vectors = np.stack([np.cos(angles), np.sin(angles)], 2).astype(np.float32)
    return np.stack([mask] * objects), vectors, keypoints


def count_by_broadcasting(
    pixels: torch.Tensor, vectors: torch.Tensor, hypotheses: torch.Tensor
) -> torch.Tensor:
    away = hypotheses[:, :, None] - pixels  # (K, S, P, 2)
    away = away / away.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    return ((away * vectors.transpose(0, 1)[:, None]).sum(-1) > 0.99).sum(-1)


COUNT = {"posecore": count_inliers, "broadcasting": count_by_broadcasting}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("library", COUNT)
def test_counting(benchmark: Callable, library: str, size: str) -> None:
    benchmark.group = f"inliers of 9 x 128 hypotheses, {size}"
    mask, vectors, keypoints = disc_and_field(size)
    rows, columns = mask[0].nonzero()
    pixels = torch.from_numpy(np.stack([columns, rows], -1)).float()
    listed = torch.from_numpy(np.moveaxis(vectors[0][:, :, rows, columns], -1, 0).copy())
    noise = 5 * torch.randn(9, 128, 2, generator=torch.Generator().manual_seed(0))
    hypotheses = torch.from_numpy(keypoints[0]).float()[:, None] + noise
    counts = benchmark(COUNT[library], pixels, listed, hypotheses)
    expected = COUNT["posecore"](pixels, listed, hypotheses)
    assert (counts - expected).abs().max() <= 5  # pixels at the threshold to float32


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("objects", [1, 3])
def test_voting(benchmark: Callable, objects: int, size: str) -> None:
    benchmark.group = f"voting, nine keypoints an object, {size} each"
    mask, vectors, keypoints = disc_and_field(size, objects)
    votes = benchmark(vote, torch.from_numpy(mask), torch.from_numpy(vectors))
    assert np.abs(votes.points.numpy() - keypoints).max() < 1


POSE = {
    "uncertainty_pnp": uncertainty_pnp,
    "pnp": lambda points, pixels, covariances, K: pnp(points, pixels, K),
}


@pytest.mark.parametrize("library", POSE)
def test_poses(benchmark: Callable, library: str) -> None:
    benchmark.group = "pose from nine keypoints"
    rng = np.random.default_rng(0)
    K = np.array([[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]])
    points = rng.uniform(-0.1, 0.1, (9, 3))
    camera = points + [0.1, -0.05, 1]
    deviations = rng.uniform(0.3, 3, 9)
    pixels = camera @ K[:2].T / camera[:, 2:] + deviations[:, None] * rng.normal(size=(9, 2))
    covariances = deviations[:, None, None] ** 2 * np.eye(2)
    found = benchmark(POSE[library], points, pixels, covariances, K)
    assert np.abs(found.t - [0.1, -0.05, 1]).max() < 0.05
