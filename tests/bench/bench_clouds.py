"""How fast clouds are beside what one would use instead: fpsample, SciPy's k-d tree, torch.cdist.

Run with `pytest -n 0 tests/bench/bench_*.py`. The others take one cloud at a time, so they are
looped over the batch. Where another promises the same result, it is compared with ours.
"""

from collections.abc import Callable

import fpsample
import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from posecore import clouds

B, N = 32, 2000


def unit_balls(seed: int) -> np.ndarray:
    """Clouds (B, N, 3) spread evenly over the unit ball, float32."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(B, N, 3))
    radii = rng.uniform(size=(B, N, 1)) ** (1 / 3)
    points = directions / np.linalg.norm(directions, axis=-1, keepdims=True) * radii
    return points.astype(np.float32)


POINTS, OTHERS = unit_balls(0), unit_balls(1)

SAMPLING = {
    "posecore": lambda: clouds.farthest_point_sampling(POINTS, 1024),
    "fpsample fps_sampling": lambda: np.stack(
        [fpsample.fps_sampling(p, 1024, start_idx=0) for p in POINTS]
    ),
    "fpsample fps_npdu_kdtree_sampling": lambda: np.stack(
        [fpsample.fps_npdu_kdtree_sampling(p, 1024, start_idx=0) for p in POINTS]
    ),
    "fpsample bucket_fps_kdline_sampling": lambda: np.stack(
        [fpsample.bucket_fps_kdline_sampling(p, 1024, h=3, start_idx=0) for p in POINTS]
    ),
}


@pytest.mark.parametrize("library", SAMPLING)
def test_farthest_point_sampling(benchmark: Callable, library: str) -> None:
    benchmark.group = f"farthest point sampling, {B} x {N} -> 1024, float32"
    indices = benchmark(SAMPLING[library])
    if library == "fpsample fps_sampling":  # npdu approximates, bucket starts elsewhere
        np.testing.assert_array_equal(indices, SAMPLING["posecore"]())


def ball_query_by_scipy(queries: np.ndarray, radius: float, count: int) -> np.ndarray:
    indices = np.empty((*queries.shape[:2], count), np.int64)
    for i in range(B):
        balls = cKDTree(POINTS[i]).query_ball_point(queries[i], radius, return_sorted=True)
        for j, found in enumerate(balls):
            some = found[:count]
            indices[i, j, : len(some)] = some
            indices[i, j, len(some) :] = some[0]
    return indices


def ball_query_by_cdist(queries: np.ndarray, radius: float, count: int) -> np.ndarray:
    """The short way on a GPU: mark, sort the indices, cut, fill."""
    inside = torch.cdist(torch.from_numpy(queries), torch.from_numpy(POINTS)) < radius
    columns = torch.where(inside, torch.arange(N), N).sort(-1).values[..., :count]
    return torch.where(columns < N, columns, columns[..., :1]).numpy()


BALLS = {
    "posecore": lambda *how: clouds.ball_query(POINTS, *how),
    "scipy query_ball_point": ball_query_by_scipy,
    "torch.cdist and sort": ball_query_by_cdist,
}


@pytest.mark.parametrize("radius", [0.2, 0.6])
@pytest.mark.parametrize("library", BALLS)
def test_ball_query(benchmark: Callable, library: str, radius: float) -> None:
    benchmark.group = f"ball query, {B} x 1024 in {N}, radius {radius}, 64 points, float32"
    how = (POINTS[:, :1024], radius, 64)
    indices = benchmark(BALLS[library], *how)
    if library != "torch.cdist and sort":  # which rounds differently
        np.testing.assert_array_equal(indices, BALLS["posecore"](*how))


NEAREST = {
    "posecore": lambda k: clouds.nearest_neighbours(POINTS, OTHERS, k)[1],
    "scipy": lambda k: np.stack(
        [cKDTree(p).query(q, np.arange(1, k + 1))[1] for p, q in zip(POINTS, OTHERS, strict=True)]
    ),
    "torch.cdist and topk": lambda k: torch.cdist(
        torch.from_numpy(OTHERS), torch.from_numpy(POINTS)
    ).topk(k, largest=False)[1],
}


@pytest.mark.parametrize("k", [1, 3, 16])
@pytest.mark.parametrize("library", NEAREST)
def test_nearest_neighbours(benchmark: Callable, library: str, k: int) -> None:
    benchmark.group = f"{k} nearest neighbours, {B} x {N} in {N}, float32"
    indices = benchmark(NEAREST[library], k)
    if library == "scipy":
        np.testing.assert_array_equal(indices, NEAREST["posecore"](k))


def chamfer_by_scipy(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    pairs = zip(a, b, strict=True)
    return np.array(
        [cKDTree(q).query(p)[0].mean() + cKDTree(p).query(q)[0].mean() for p, q in pairs]
    )


def chamfer_by_cdist(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    distances = torch.cdist(a, b)
    return distances.amin(1).mean(-1) + distances.amin(2).mean(-1)


@pytest.mark.parametrize("library", ["posecore", "scipy", "torch.cdist"])
def test_chamfer_distance(benchmark: Callable, library: str) -> None:
    benchmark.group = f"Chamfer distance, {B} x {N} x {N}, float32"
    if library == "torch.cdist":
        value = benchmark(chamfer_by_cdist, torch.from_numpy(POINTS), torch.from_numpy(OTHERS))
    else:
        function = chamfer_by_scipy if library == "scipy" else clouds.chamfer_distance
        value = benchmark(function, POINTS, OTHERS)
    np.testing.assert_allclose(value, chamfer_by_scipy(POINTS, OTHERS), rtol=1e-3)


@pytest.mark.parametrize("library", ["posecore", "torch.cdist"])
def test_chamfer_distance_and_its_derivative(benchmark: Callable, library: str) -> None:
    benchmark.group = f"Chamfer distance forward and backward, {B} x {N} x {N}, float32"
    function = chamfer_by_cdist if library == "torch.cdist" else clouds.chamfer_distance
    a = torch.from_numpy(POINTS).requires_grad_()
    (gradient,) = benchmark(
        lambda: torch.autograd.grad(function(a, torch.from_numpy(OTHERS)).sum(), a)
    )
    assert torch.isfinite(gradient).all()


def interpolate_by_indexing(
    features: torch.Tensor, indices: torch.Tensor, weights: torch.Tensor
) -> torch.Tensor:
    cloud = torch.arange(len(features))[:, None, None]
    return (features[cloud, indices] * weights[..., None]).sum(-2)


@pytest.mark.parametrize("library", ["posecore", "indexing"])
def test_interpolation_and_its_derivative(benchmark: Callable, library: str) -> None:
    benchmark.group = (
        f"interpolation forward and backward, {B} x 512 -> 1024, 256 channels, float32"
    )
    points = torch.from_numpy(POINTS[:, :1024])
    indices, weights = clouds.interpolation_weights(points[:, :512], points)
    features = torch.randn(B, 512, 256, generator=torch.Generator().manual_seed(0))
    features.requires_grad_()
    function = clouds.interpolate if library == "posecore" else interpolate_by_indexing
    (gradient,) = benchmark(
        lambda: torch.autograd.grad(function(features, indices, weights).sum(), features)
    )
    assert torch.isfinite(gradient).all()


@pytest.mark.usefixtures("one_core")
@pytest.mark.parametrize("what", ["rows", "sum"])
@pytest.mark.parametrize("library", ["posecore", "indexing"])
def test_gathering_and_its_derivative(benchmark: Callable, library: str, what: str) -> None:
    """With a gradient for every number, as a layer gives it, and with one for all, of their sum."""
    benchmark.group = (
        f"gathering forward and backward of {what}, {B} x 512 x 16 of 1024 points, 128 channels"
    )
    generator = torch.Generator().manual_seed(0)
    indices = torch.randint(0, 1024, (B, 512, 16), generator=generator)
    values = torch.randn(B, 1024, 128, generator=generator).requires_grad_()
    cloud = torch.arange(B)[:, None, None]
    function = {"posecore": clouds.gather_points, "indexing": lambda v, i: v[cloud, i]}[library]
    above = torch.randn(B, 512, 16, 128, generator=generator)
    if what == "sum":
        above = torch.ones(()).expand(above.shape)
    (gradient,) = benchmark(lambda: torch.autograd.grad(function(values, indices), values, above))
    expected = torch.autograd.grad(values[cloud, indices], values, above)[0]
    assert torch.equal(gradient, expected)


@pytest.mark.parametrize("library", ["posecore"])
def test_normals(benchmark: Callable, library: str) -> None:
    benchmark.group = f"normals from 16 neighbours, {B} x {N}, float32"
    normals = benchmark(clouds.estimate_normals, POINTS, 16)
    assert np.isfinite(normals).all()
