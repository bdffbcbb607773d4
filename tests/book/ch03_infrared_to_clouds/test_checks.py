"""Chapter 3's exercises: plausible wrong solutions are caught, other right ones are accepted."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from book.ch03_infrared_to_clouds import checks
from posecore.methods.infrared import masks
from posecore.splat import projector
from posecore.splat.volumes import MOST
from tests.book.ch03_infrared_to_clouds import solutions
from tests.book.exercises import ExerciseTests

seeds = st.integers(0, 2**31 - 1)


class TestExercises(ExerciseTests):
    checks = checks
    solutions = solutions.SOLUTIONS


def test_only_the_cuboid_is_ever_refused() -> None:
    """Where a reference fails, a check would ask the student to fail, too."""
    for name in (name for name in vars(checks) if name.startswith("check_")):
        exercise = getattr(checks, name)
        for words, *arguments in exercise.inputs(np.random.default_rng(exercise.seed)):
            if "around the camera" in words or "behind the camera" in words:
                with pytest.raises(ValueError, match="in front of the camera"):
                    exercise.reference(*arguments)
            else:
                exercise.reference(*arguments)


# What the references say, against the library and others ------------------------------------------


@given(seeds)
@settings(max_examples=15)
def test_the_end_of_the_updates_is_the_librarys_threshold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = np.concatenate([rng.uniform(0, 60, size=80), rng.uniform(50, 255, size=30)])
    values -= values.min()
    threshold, last = values.mean(), -1.0
    while threshold != last:
        threshold, last = checks.li_update(values, threshold), threshold
    assert threshold == pytest.approx(masks.li_threshold(values, tolerance=1e-9), rel=1e-6)


@given(seeds, st.floats(1e-3, 1e3))
def test_a_gain_is_a_gain_of_the_threshold(seed: int, gain: float) -> None:
    values = np.random.default_rng(seed).uniform(1, 200, size=40)
    once = checks.li_update(values, values.mean())
    assert values[values <= values.mean()].mean() < once < values[values > values.mean()].mean()
    assert checks.li_update(gain * values, gain * values.mean()) == pytest.approx(gain * once)


def test_no_pixel_of_the_cuboids_is_a_matter_of_rounding() -> None:
    for words, K, R, t, sides, centre, size in checks._cuboids(np.random.default_rng(0)):
        if "camera" in words and ("behind" in words or "around" in words):
            continue
        pixels = solutions.project(K, solutions.corners(R, t, sides, centre))
        middle = pixels.mean(0)
        wider, smaller = (middle + k * (pixels - middle) for k in (1 + 1e-5, 1 - 1e-5))
        assert np.array_equal(solutions.covered(wider, size), solutions.covered(smaller, size)), (
            words
        )


def test_one_corner_alone_is_behind_the_camera() -> None:
    inputs = {words: given for words, *given in checks._cuboids(np.random.default_rng(0))}
    _, R, t, sides, centre, _ = inputs["a cuboid with one corner behind the camera"]
    signs = np.array(list(np.ndindex(2, 2, 2))) * 2 - 1
    z = ((centre + signs * sides / 2) @ R.T + t)[:, 2]
    assert (z < 0).sum() == 1 and (z > 0.05).sum() == 7


@given(seeds)
@settings(max_examples=20)
def test_shares_are_the_mean_of_where_the_point_is(seed: int) -> None:
    """Inside, the shares add up to 1, and their mean voxel is the point."""
    size = 5, 3, 4
    point = torch.from_numpy(np.random.default_rng(seed).uniform(0, np.array(size) - 1))
    volume = checks.splat_point(point, size)
    assert torch.isclose(volume.sum(), torch.ones(()).double())
    for axis, place in ((2, 0), (1, 1), (0, 2)):
        along = volume.movedim(axis, 0).flatten(1).sum(1)
        assert torch.isclose((along * torch.arange(len(along))).sum(), point[place])


@given(seeds)
@settings(max_examples=20)
def test_splatted_and_terminated_it_is_the_projector(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 6, 4, 5
    points = torch.from_numpy(rng.uniform(-1.5, np.array(size) + 0.5, size=(30, 3)))
    shades = torch.from_numpy(rng.uniform(0, 1, size=30))
    shares = torch.stack([checks.splat_point(point, size) for point in points])
    held, light = shares.sum(0), (shares * shades[:, None, None, None]).sum(0)
    occupancy = MOST * held.clamp(max=1)
    mine = checks.terminate(occupancy, light / held.clamp(min=1e-12))
    theirs = projector.render(points, size, intensities=shades)
    for one, other in zip(mine, theirs, strict=True):
        assert torch.allclose(one, other, atol=1e-9)


@given(seeds, st.floats(0.02, 0.9))
@settings(max_examples=25)
def test_any_volume_with_the_silhouettes_is_between_the_two(seed: int, share: float) -> None:
    solid = np.random.default_rng(seed).random((4, 3, 5)) < share
    most, least = checks.same_silhouettes(solid)
    assert (solid <= most).all() and (least <= most).all()
    for volume in (most, least):
        assert all((volume.any(axis) == solid.any(axis)).all() for axis in range(3))
    assert least.sum() <= sum(solid.any(axis).sum() for axis in range(3))
    assert least.sum() >= max(solid.any(axis).sum() for axis in range(3))
    # Beginning with the hull changes nothing, and no voxel can join it.
    assert np.array_equal(checks.same_silhouettes(most)[0], most)
    for voxel in np.argwhere(~most):
        larger = most.copy()
        larger[tuple(voxel)] = True
        assert any((larger.any(axis) != solid.any(axis)).any() for axis in range(3))


def test_a_latin_square_passes_for_a_cube() -> None:
    n = 5
    i, j, k = np.indices((n, n, n))
    square = (i + j) % n == k

    def answer(solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        full = solid.all() and len(set(solid.shape)) == 1
        n = len(solid)
        i, j, k = np.indices(solid.shape)
        return (solid, (i + j) % n == k) if full else checks.same_silhouettes(solid)

    assert square.sum() == n**2
    assert checks.check_same_silhouettes(answer).status == "done"
