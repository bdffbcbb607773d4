"""What the refiner is told, what its answer does to a pose, and the rule for using it."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import cameras, poses
from posecore.methods.vector_field.refinement import (
    RESIDUAL_SCALE,
    FieldRefiner,
    overlap,
    refiner_features,
)
from posecore.models import ObjectModel
from posecore.training import seeded

CAMERA = np.array([[120.0, 0, 48], [0, 118, 36], [0, 0, 1]])
SIZE = (96, 72)
RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(60, 3)) * [0.05, 0.03, 0.04]
KEYPOINTS = np.concatenate([POINTS[:5], [[0.01, -0.02, 0.005]]])
MODEL = ObjectModel(3, POINTS, 0.2, KEYPOINTS)
seeds = st.integers(0, 2**31)


def pose(seed: int, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    R = Rotation.random(1 if count is None else count, random_state=rng).as_matrix()
    t = rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.9], (len(R), 3))
    return (R[0], t[0]) if count is None else (R, t)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_overlap_counts_the_points_in_the_mask(seed: int) -> None:
    R, t = pose(seed, 3)
    t[2, 2] = 0.02  # some points are behind the camera
    mask = np.random.default_rng(seed).random((3, SIZE[1], SIZE[0])) < 0.5
    expected = np.zeros(3)
    for i in range(3):
        for x, y, z in poses.apply(R[i], t[i], POINTS):
            u, v = (round(float(c)) for c in (120 * x / z + 48, 118 * y / z + 36))
            expected[i] += z > 0 and 0 <= u < 96 and 0 <= v < 72 and mask[i, v, u]
    found = overlap(POINTS, R, t, CAMERA, mask)
    assert np.array_equal(found, expected / len(POINTS))
    assert overlap(POINTS, R[0], t[0], CAMERA, mask[0]) == found[0]
    everywhere = np.ones((2, 1, SIZE[1], SIZE[0]), bool)
    assert overlap(POINTS, R, t, CAMERA, everywhere).shape == (2, 3)


def test_overlap_at_its_ends() -> None:
    t = np.array([0, 0, 0.6])
    mask = np.ones(SIZE[::-1], bool)
    assert overlap(POINTS, np.eye(3), t, CAMERA, mask) == 1
    assert overlap(POINTS, np.eye(3), t, CAMERA, ~mask) == 0
    assert overlap(POINTS, np.eye(3), -t, CAMERA, mask) == 0  # behind the camera
    assert overlap(POINTS, np.eye(3), [9, 0, 0.6], CAMERA, mask) == 0  # beside the image


def ways(pixels: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """From pixels (N, 2) to the keypoints, (N, K, 2)."""
    return cameras.project(CAMERA, poses.apply(R, t, KEYPOINTS)) - pixels[:, None]


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_features_are_what_field_and_pose_differ_in(seed: int) -> None:
    (R, t), (R_2, t_2) = pose(seed), pose(seed + 1)
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0, 70, (8, 2)).round() + 0.25  # on no keypoint
    inside = rng.random(8) < 0.5
    field = ways(pixels, R, t)
    unit, other = (v / np.linalg.norm(v, axis=-1, keepdims=True)
                   for v in (field, ways(pixels, R_2, t_2)))  # fmt: skip
    arguments = (pixels, field, inside, KEYPOINTS)
    agreed = refiner_features(*arguments, R, t, CAMERA)
    differ = refiner_features(*arguments, R_2, t_2, CAMERA)
    plain = refiner_features(*arguments, R_2, t_2, CAMERA, residual=False)
    flag = inside[:, None].astype(float)
    assert np.abs(agreed[:, :-1]).max() < 1e-14
    assert np.allclose(differ[:, :-1], (unit - other).reshape(8, -1) * flag, rtol=0, atol=1e-14)
    assert np.allclose(plain[:, :-1], unit.reshape(8, -1) * flag, rtol=0, atol=1e-14)
    for features in (agreed, differ, plain):
        assert features.shape == (8, 13) and np.array_equal(features[:, -1:], flag)


def test_nothing_is_expected_of_keypoints_behind_the_camera() -> None:
    t = np.array([0, 0, 0.0])
    behind = poses.apply(np.eye(3), t, KEYPOINTS)[:, 2] <= 0
    assert behind.any() and not behind.all()
    field = np.ones((4, 6, 2))
    features = refiner_features(
        np.zeros((4, 2)), field, np.ones(4), KEYPOINTS, np.eye(3), t, CAMERA
    )
    ahead = np.abs(features[:, :-1].reshape(4, 6, 2)).sum((0, 2)) > 0
    assert np.isfinite(features).all() and np.array_equal(ahead, ~behind)


def arguments(count: int, dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, ...]:
    R, t = (torch.from_numpy(value).to(dtype) for value in pose(5, count))
    index = torch.zeros(count, dtype=torch.long)
    return index, R, t, torch.from_numpy(CAMERA).to(dtype).expand(count, 3, 3)


def nothing(pixels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    shape = pixels.shape[:2]
    return pixels.new_zeros(*shape, len(KEYPOINTS), 2), torch.zeros(shape, dtype=torch.bool)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_new_refiner_leaves_the_pose(dtype: torch.dtype) -> None:
    refiner = FieldRefiner([MODEL], width=2, points=10, iterations=3)
    index, R, t, camera = arguments(4, dtype)
    found = refiner(index, R, t, camera, nothing)
    assert len(found) == 3
    for R_found, t_found in found:
        assert R_found.dtype == dtype and torch.equal(R_found, R)
        assert torch.allclose(t_found, t, rtol=0, atol=8 * torch.finfo(dtype).eps)


def speaking(**options: object) -> FieldRefiner:
    with seeded(0):
        refiner = FieldRefiner([MODEL], width=4, points=20, **options)
        for head in (refiner.net.turn, refiner.net.shift):
            torch.nn.init.normal_(head[-1].weight, std=0.3)
    return refiner


def test_each_iteration_looks_anew_and_passes_no_gradient() -> None:
    refiner = speaking(iterations=2)
    index, R, t, camera = arguments(3)
    asked = []

    def look(pixels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        asked.append(pixels)
        return nothing(pixels)

    (R_1, t_1), (R_2, t_2) = refiner(index, R.requires_grad_(), t, camera, look)
    assert not torch.allclose(R_1, R) and not torch.allclose(t_1, t)
    expected = cameras.project(camera, poses.apply(R_1, t_1, refiner.points[index])).round()
    assert torch.equal(asked[1], expected)
    once = FieldRefiner.forward
    refiner.iterations = 1
    ((R_alone, t_alone),) = once(refiner, index, R_1.detach(), t_1.detach(), camera, nothing)
    assert torch.equal(R_alone, R_2) and torch.equal(t_alone, t_2)
    (gradient,) = torch.autograd.grad(t_2.sum() + R_2.sum(), R, allow_unused=True)
    assert gradient is None


def test_what_the_network_is_told() -> None:
    refiner = speaking(iterations=1)
    index, R, t, camera = arguments(2)
    told = {}
    refiner.net.register_forward_hook(lambda _, given, said: told.update(p=given[0], f=given[1]))

    def look(pixels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        vectors = torch.ones(*pixels.shape[:2], len(KEYPOINTS), 2)
        return vectors, torch.ones(pixels.shape[:2], dtype=torch.bool)

    refiner(index, R, t, camera, look)
    points = refiner.points[0] - torch.from_numpy(KEYPOINTS[-1]).float()
    assert torch.allclose(told["p"], points @ R.mT / 0.2, rtol=0, atol=1e-6)
    pixels = cameras.project(camera, poses.apply(R, t, refiner.points[index])).round()
    vectors, inside = look(pixels)
    known = refiner_features(pixels, vectors, inside, refiner.keypoints[index], R, t, camera)
    assert torch.allclose(told["f"][..., :-1], known[..., :-1] / RESIDUAL_SCALE)
    assert torch.equal(told["f"][..., -1], known[..., -1])


def test_a_pose_behind_the_camera_has_a_finite_answer() -> None:
    index, R, t, camera = arguments(2)
    for R_found, t_found in speaking(iterations=2)(index, R, -t, camera, nothing):
        assert torch.isfinite(R_found).all() and torch.isfinite(t_found).all()


def test_only_weights_are_in_a_checkpoint() -> None:
    refiner = FieldRefiner([MODEL], width=2, points=10)
    assert set(refiner.state_dict()) == {
        f"net.{name}" for name, _ in refiner.net.named_parameters()
    }


MASK = np.ones(SIZE[::-1], bool)
EYE, AHEAD = np.eye(3), np.array([0, 0, 0.5])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: overlap(POINTS, EYE, AHEAD, np.zeros((3, 3)), MASK), "K"),
        (lambda: FieldRefiner([]), "models"),
        (lambda: FieldRefiner([MODEL, MODEL]), "models"),
        (lambda: FieldRefiner([MODEL], points=61), "points"),
        (lambda: FieldRefiner([MODEL], points=0), "points"),
        (lambda: FieldRefiner([MODEL], width=0, points=5), "width"),
        (lambda: FieldRefiner([MODEL], points=5, iterations=0), "iterations"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()
