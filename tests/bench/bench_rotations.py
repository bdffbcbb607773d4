"""How fast rotations are beside RoMa. Run with `pytest -n 0 tests/bench/bench_*.py`.

`--benchmark-timer=time.process_time` counts the time of this process alone, on a machine that
others use too. RoMa solves Procrustes by a quartic in float64 ("horn", its default) or by LAPACK
("svd").
"""

from collections.abc import Callable

import numpy as np
import pytest
import roma
import torch

from posecore.rotations import (
    geodesic_distance,
    matrix_to_quaternion,
    quaternion_to_matrix,
    random_rotations,
    special_procrustes,
)

N = 100_000

PROCRUSTES = {
    "posecore": special_procrustes,
    "roma": roma.special_procrustes,
    "roma by svd": lambda M: roma.special_procrustes(M, method="svd"),
}
TO_MATRIX = {
    "posecore": quaternion_to_matrix,
    "roma": lambda q: roma.unitquat_to_rotmat(roma.quat_normalize(roma.quat_wxyz_to_xyzw(q))),
}
TO_QUATERNION = {
    "posecore": matrix_to_quaternion,
    "roma": lambda R: roma.quat_xyzw_to_wxyz(roma.rotmat_to_unitquat(R)),
}
DISTANCE = {"posecore": geodesic_distance, "roma": roma.rotmat_geodesic_distance}


def forward_and_backward(function: Callable, x: torch.Tensor) -> torch.Tensor:
    leaf = x.detach().requires_grad_()
    out = function(leaf)
    out.backward(torch.ones_like(out))
    return leaf.grad


@pytest.mark.parametrize("kind", ["random", "rotations"])
@pytest.mark.parametrize("library", PROCRUSTES)
def test_procrustes_and_its_derivative(benchmark: Callable, library: str, kind: str) -> None:
    benchmark.group = f"Procrustes forward and backward, {N} {kind}, float32"
    if kind == "random":
        M = torch.randn(N, 3, 3, generator=torch.Generator().manual_seed(0))
    else:
        M = random_rotations(N, generator=0)
    grad = benchmark(forward_and_backward, PROCRUSTES[library], M)
    assert torch.isfinite(grad).all()


@pytest.mark.parametrize("n", [1, 32, 1024])
@pytest.mark.parametrize("library", PROCRUSTES)
def test_procrustes_of_small_batches(benchmark: Callable, library: str, n: int) -> None:
    benchmark.group = f"Procrustes forward and backward, {n} random, float32"
    M = torch.randn(n, 3, 3, generator=torch.Generator().manual_seed(0))
    grad = benchmark(forward_and_backward, PROCRUSTES[library], M)
    assert torch.isfinite(grad).all()


@pytest.mark.parametrize("library", TO_MATRIX)
def test_quaternion_to_matrix(benchmark: Callable, library: str) -> None:
    benchmark.group = f"quaternion to matrix, {N}, float32"
    q = torch.randn(N, 4, generator=torch.Generator().manual_seed(0))
    R = benchmark(TO_MATRIX[library], q)
    assert torch.allclose(R, quaternion_to_matrix(q), atol=1e-5)


@pytest.mark.usefixtures("one_core")
@pytest.mark.parametrize("library", TO_QUATERNION)
def test_matrix_to_quaternion(benchmark: Callable, library: str) -> None:
    benchmark.group = f"matrix to quaternion, {N}, float32"
    R = random_rotations(N, generator=0)
    q = benchmark(TO_QUATERNION[library], R)
    assert torch.allclose(quaternion_to_matrix(q), R, atol=1e-5)


@pytest.mark.usefixtures("one_core")
@pytest.mark.parametrize("library", DISTANCE)
def test_distance(benchmark: Callable, library: str) -> None:
    benchmark.group = f"geodesic distance, {N}, float32"
    one, two = random_rotations(2, N, generator=0)
    angle = benchmark(DISTANCE[library], one, two)
    assert np.pi / 2 < angle.mean() < 2.5  # of uniform rotations 2.21
