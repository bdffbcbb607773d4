"""An instant of the headset world, and its light."""

import copy

import numpy as np
import pytest

from data_tools.renderer import render_infrared, render_labels
from data_tools.worlds import headset_scenes
from data_tools.worlds.headset import WORLD, cameras
from data_tools.worlds.headset_scenes import draw_instant, infrared_picture, visible_picture
from data_tools.worlds.world import generator
from posecore.poses import apply

pytestmark = pytest.mark.slow


def test_light_falls_with_the_square_of_the_distance():
    """The same piece of a cheek, moved away along the axis of the camera.

    A lamp 4 cm aside is seen from it under another angle, by 4.6 degrees at 0.5 m and 2.3 at 1 m;
    where the light comes in at up to 30 degrees the cosine changes by up to 2.5 % for that, and the
    lamp's beam by less than 1 %.
    """
    head = headset_scenes.driver(3)[0]
    K, T = cameras(320, 188)[1]
    # The lamp alone: no daylight.
    (lamp,) = headset_scenes.infrared_lights(T, 0.0)
    spot = np.array([0.03, 0.035, 0.0])
    light = []
    for distance in (0.5, 0.7, 1.0):
        t = np.array([0, 0, distance])
        scene = [head], [(np.eye(3), t)], K, (320, 188)
        labels = render_labels(*scene)
        linear = render_infrared(*scene, [lamp], ambient=0.0)
        near = np.linalg.norm((labels.coordinates - spot)[..., :2], axis=-1) < 0.012
        near &= labels.instance == 0
        square = ((labels.coordinates[near] + t - lamp.position) ** 2).sum(-1)
        light.append((linear[near].mean(), np.mean(1 / square)))
    brightness, expected = np.array(light).T
    assert near.sum() > 20
    assert brightness[0] > 3 * brightness[-1]
    ratio = brightness / expected
    assert np.ptp(ratio) < 0.035 * ratio.mean()


def test_most_heads_look_ahead_and_some_far_to_the_side(rng):
    angles = np.degrees([headset_scenes.draw_angles(rng) for _ in range(6000)])
    yaw, pitch, roll = np.abs(angles).T
    assert yaw.max() <= 75
    assert pitch.max() <= 35
    assert roll.max() <= 25
    assert 0.5 < np.mean((yaw < 15) & (pitch < 15)) < 0.8
    # Every bin of 15 degrees of yaw, 10 of pitch and 5 of roll has some, and fewer than the first.
    for values, width, bins in ((yaw, 15, 5), (pitch, 10, 3), (roll, 5, 5)):
        counts = np.bincount((values // width).astype(int), minlength=bins)[:bins]
        assert counts.min() > 10
        assert counts[-1] < 0.1 * counts[0]
    assert abs(angles[:, 0].mean()) < 3


def test_signs_of_the_head_angles():
    """As the centre camera sees it: yaw moves the nose to the left, pitch lowers it, and roll turns
    the head clockwise."""
    nose, crown = np.array([[0, 0.035, -0.03]]), np.array([[0, -0.12, 0.08]])
    for axis, angle in enumerate((0.4, 0.3, 0.3)):
        R, t = headset_scenes.about_pivot(angle * np.eye(3)[axis], np.zeros(3))
        straight = headset_scenes.about_pivot(np.zeros(3), np.zeros(3))
        moved_nose = (apply(R, t, nose) - apply(*straight, nose))[0]
        moved_crown = (apply(R, t, crown) - apply(*straight, crown))[0]
        if axis == 0:
            assert moved_nose[0] < -0.03
        elif axis == 1:
            assert moved_nose[1] > 0.03
        else:
            assert moved_crown[0] > 0.03


def test_both_lights_take_the_same_random_numbers():
    """So that all cameras see the same world outside, whichever picture was taken first."""
    rng = generator(WORLD.recipe("train", "tiny"), 3)
    instant = draw_instant(rng, "train", 3)
    camera, size = cameras(80, 47)[0], (80, 47)
    other = copy.deepcopy(rng)
    infrared = infrared_picture(instant, *camera, size, rng)
    visible = visible_picture(instant, *camera, size, other)
    assert infrared.shape == (47, 80) and visible.shape == (47, 80, 3)
    assert rng.random() == other.random()


def test_an_instant_is_seen_from_a_camera_where_it_is_in_the_car():
    instant = draw_instant(np.random.default_rng(0), "train", 0)
    _, T = cameras(80, 47)[2]
    point = np.array([[0.01, 0.02, 0.03]])
    for pose, seen in zip(instant.poses, instant.seen_from(T), strict=True):
        in_car = apply(T[:3, :3], T[:3, 3], apply(*seen, point))
        assert np.allclose(in_car, apply(*pose, point), atol=1e-12)
