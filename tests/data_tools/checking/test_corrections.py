"""Each correction undoes its mistake: made upon the mistake, what comes out is what was right."""

from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.corrections import (
    camera_corrections,
    mask_corrections,
    pose_corrections,
)

FLIP = np.diag([1.0, -1, -1])


def of(corrections, key, number=0):
    return [c for c in corrections if c.key == key][number]


def with_pose(instance, R, t):
    return replace(instance, item=replace(instance.item, R=R, t=t))


@pytest.mark.parametrize(
    ("key", "make"),
    [
        ("inverse poses", lambda R, t: (R.T, -R.T @ t)),
        ("transposed rotations", lambda R, t: (R.T, t)),
        ("flipped axes", lambda R, t: (FLIP @ R, FLIP @ t)),
        ("turned axes", lambda R, t: (np.diag([-1, -1, 1]) @ R, np.diag([-1, -1, 1]) @ t)),
    ],
)
def test_poses(sample, key, make):
    for instance in sample.instances:
        wrong = with_pose(instance, *make(instance.item.R, instance.item.t))
        place = of(pose_corrections(sample), key).place(wrong)
        np.testing.assert_allclose(place.R, instance.item.R, atol=1e-12)
        np.testing.assert_allclose(place.t, instance.item.t, atol=1e-12)
        assert place.K is instance.K and place.scale == 1


def test_poses_of_neighbours(sample):
    after = of(pose_corrections(sample), "shifted by one image", 0)
    before = of(pose_corrections(sample), "shifted by one image", 1)
    first, third = sample.instances[0], sample.instances[2]
    assert after.place(first).t is third.item.t and before.place(third).t is first.item.t
    assert before.place(first) is None
    assert "next" in after.mistake and "previous" in before.mistake


def test_turned_models(sample):
    turned = [c for c in pose_corrections(sample) if c.key == "turned model"]
    assert len({c.mistake for c in turned}) == 23
    instance = with_pose(sample.instances[0], np.eye(3), np.array([0, 0, 1.0]))
    for correction in turned:
        R = correction.place(instance).R
        assert np.linalg.det(R) == pytest.approx(1) and not np.array_equal(R, np.eye(3))
        names = correction.mistake.rpartition("models are ")[2].removesuffix(" of the poses")
        for column, name in zip(R.T, names.split(", "), strict=True):  # R x_model is "-z" of poses
            axis = np.eye(3)["xyz".index(name[-1])] * (-1 if name[0] == "-" else 1)
            np.testing.assert_array_equal(column, axis)


@pytest.mark.parametrize(
    ("key", "K"),
    [
        ("swapped fx and fy", [[200, 0, 83], [0, 170, 57], [0, 0, 1]]),
        ("swapped cx and cy", [[170, 0, 57], [0, 200, 83], [0, 0, 1]]),
        ("swapped x and y", [[200, 0, 57], [0, 170, 83], [0, 0, 1]]),
    ],
)
def test_cameras(sample, key, K):
    instance = replace(sample.instances[0], K=np.array(K, float))
    place = of(camera_corrections(), key).place(instance)
    np.testing.assert_array_equal(place.K, sample.instances[0].K)
    assert place.R is instance.item.R and place.t is instance.item.t


@pytest.mark.parametrize(("key", "axis"), [("mirrored images", 1), ("images upside down", 0)])
def test_mirrors(sample, key, axis):
    instance = sample.instances[0]
    point = instance.item.t
    x, y, z = instance.K @ point
    seen = of(camera_corrections(), key).place(instance).K @ point
    expected = [159 - x / z, y / z] if axis else [x / z, 119 - y / z]
    np.testing.assert_allclose(seen[:2] / seen[2], expected)


def test_masks(sample):
    others, inverted = mask_corrections(sample)
    first, second = sample.instances[:2]
    assert others.targets(first) == [second] and others.targets(second) == [first]
    (target,) = inverted.targets(first)
    assert np.array_equal(target.mask, ~first.mask) and np.array_equal(target.small, ~first.small)
