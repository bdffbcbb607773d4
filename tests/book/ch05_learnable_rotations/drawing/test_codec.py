"""The figures of chapter 5 on the codec show the numbers that they were given, and say so."""

import numpy as np
import pytest
import torch

from book.ch05_learnable_rotations.drawing import codec as codes
from posecore import rotations
from posecore.figures import Picture
from posecore.nets.rotation_heads import RotationCodec, RotationHead, train_codec

pytestmark = pytest.mark.slow

R = rotations.random_rotations(50, generator=3, dtype=torch.float32)


@pytest.fixture(scope="module")
def codec() -> RotationCodec:
    return train_codec(seed=0, steps=60)


def check(figure: Picture, panels: int, kilobytes: int) -> None:
    assert len(figure.axes) == panels
    assert len(figure.alt) > 60 and len(figure.png()) < 1000 * kilobytes


def shown(axes) -> np.ndarray:
    return np.array([float(text.get_text()) for text in axes.texts]).reshape(3, 3)


def test_the_pipeline_shows_every_layer(codec):
    figure = codes.pipeline(codec, R[0])
    check(figure, 6, 40)
    shapes = [np.shape(axes.images[0].get_array()) for axes in figure.axes]
    assert shapes == [(3, 3), (9, 8), (16, 8), (16, 8), (3, 3), (3, 3)]
    for place, numbers in ((0, R[0]), (4, codec.encode(R[0]).reshape(3, 3)), (5, codec(R[0]))):
        assert np.abs(shown(figure.axes[place]) - numbers.numpy()).max() <= 0.0051
    off = torch.rad2deg(rotations.geodesic_distance(codec(R[0]), R[0]))
    assert f"{off:.1f}°" in figure.alt
    assert not codec.project._forward_hooks and not codec.project._forward_pre_hooks
    # LeakyReLU leaves next to nothing of what is negative.
    before, after = (np.asarray(figure.axes[k].images[0].get_array()) for k in (2, 3))
    assert before.min() < -0.1 * before.max() and after.min() > -0.1 * after.max()


def test_codes_stand_below_their_rotations():
    figure = codes.side_by_side(R[:4], 2 * R[:4], 2.0)
    check(figure, 8, 60)
    for above, below, true in zip(figure.axes[:4], figure.axes[4:], R, strict=False):
        assert np.array_equal(shown(above), shown(below))
        assert np.abs(shown(above) - true.numpy()).max() <= 0.0051


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_plane_part_of_a_turn_is_its_cosine_and_sine(axis):
    angles = torch.linspace(-3, 3, 13, dtype=torch.float64)
    unit = torch.eye(3, dtype=torch.float64)[axis]
    turns = rotations.axis_angle_to_matrix(angles[:, None] * unit)
    expected = torch.stack([angles.cos(), angles.sin()], -1)
    assert torch.allclose(codes.plane_part(turns, axis), expected)
    # Whatever symmetric P stands behind a turn, it moves along the ray.
    half = torch.randn(13, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    part = codes.plane_part(turns @ half @ half.mT, axis)
    length = part.norm(dim=-1, keepdim=True)
    assert torch.allclose(part / length, expected) and length.min() > 0


def test_rays_meet_the_loops(codec):
    figure = codes.rays({"one": codec, "other": codec})
    check(figure, 3, 60)
    for axes in figure.axes:
        circle, loop = (axes.lines[k].get_xydata() for k in (0, 1))
        assert np.allclose(np.linalg.norm(circle, axis=1), 1, atol=1e-5)
        between = np.arctan2(loop[:, 1], loop[:, 0]) - np.arctan2(circle[:, 1], circle[:, 0])
        off = np.abs((between + np.pi) % (2 * np.pi) - np.pi)
        assert off.max() < np.radians(15)  # after 60 steps
    assert figure.legends[0].get_texts()[2].get_text() == "other"


def test_distances_lie_about_the_chord():
    angles = np.linspace(0.1, 3, 20)
    chord = 2 * np.sqrt(2) * np.sin(angles / 2)
    figure = codes.near_and_far(angles, {"exact": chord, "twice": 2 * chord})
    check(figure, 2, 40)
    dots = figure.axes[1].collections[0].get_offsets()
    assert np.allclose(dots, np.stack([np.degrees(angles), 2 * chord], -1))
    line = figure.axes[0].lines[0].get_xydata()
    assert np.allclose(np.interp(np.degrees(angles), *line.T), chord, atol=1e-3)
    assert "exact: up to 0% off" in figure.alt and "twice: up to 100% off" in figure.alt


def test_training_shows_error_and_size():
    history = np.column_stack([np.geomspace(100, 0.5, 400), np.linspace(-0.1, 3, 400)])
    figure = codes.training({"slow": history, "fast": history[::2]})
    check(figure, 2, 60)
    error, size = (axes.lines[0].get_xydata() for axes in figure.axes)
    assert error[0].tolist() == [1, 100] and np.allclose(error[-1], [400, 0.5])
    assert np.isnan(size[0, 1]) and np.isclose(size[-1, 1], 3)  # a log axis has no place below 0
    assert figure.axes[1].lines[1].get_xdata()[-1] == 200
    assert "slow: 0.5°, size 3" in figure.alt


def test_spectra_are_shares():
    values = np.tile([1.0, 2.0, 3.0], (10, 1))
    figure = codes.spectra({"same": values, "wide": values * [0.5, 1, 1.2]})
    check(figure, 2, 40)
    outlines = figure.axes[0].patches[1::2]
    for outline, place in zip(outlines, (0.5, 1.0, 1.5), strict=True):
        heights, edges, _ = outline.get_data()
        assert np.isclose(heights.sum(), 100)
        assert edges[heights.argmax()] <= place + 1e-9 <= edges[heights.argmax() + 1] + 1e-9
    assert "same: 0.50 to 1.50" in figure.alt


def test_bars_have_the_length_of_their_cost():
    figure = codes.sizes(["R itself", "a codec"], [0.025, 0.5])
    check(figure, 1, 20)
    assert [bar.get_width() for bar in figure.axes[0].patches] == [0.025, 0.5]
    assert "a codec 0.500" in figure.alt


def test_a_full_turn_is_torn_where_it_jumps():
    turn = np.linspace(0, 2 * np.pi, 361)
    walk = rotations.axis_angle_to_matrix(turn[:, None] * np.array([0, 0.6, 0.8]))
    heads = {name: RotationHead(name, "output") for name in ("quaternion", "axis_angle", "6d")}
    targets = {name: head.encode(walk) for name, head in heads.items()}
    targets |= {f"{name} again": value for name, value in targets.items()}
    figure = codes.one_turn(turn, targets)
    check(figure, 6, 80)
    assert "Torn: quaternion, axis_angle, quaternion again" in figure.alt
    for axes, values in zip(figure.axes, targets.values(), strict=True):
        torn = "torn 1 x" in axes.get_title()
        curves = [line.get_ydata() for line in axes.lines[: values.shape[1]]]
        assert [np.isnan(curve).sum() for curve in curves] == [int(torn)] * len(curves)
        drawn = np.stack([curve[~np.isnan(curve)] for curve in curves], -1)
        assert np.array_equal(drawn, values)
        if torn:
            assert abs(axes.lines[-1].get_xdata()[0] - 180) <= 1
    assert "whole" in figure.axes[2].get_title()


def test_maps_of_encoded_numbers():
    x = np.linspace(-1, 1, 21)
    far = np.abs(x[:, None] - x)
    wrapped = np.abs(np.sin(np.pi * (x[:, None] - x) / 2))
    figure = codes.wave_distances(x, {"far": far, "wrapped": wrapped})
    check(figure, 2, 40)
    assert "far: the corner that is furthest from the diagonal is far" in figure.alt
    assert "wrapped: the corner that is furthest from the diagonal is near" in figure.alt
    image = figure.axes[0].images[0]
    assert image.get_extent() == [-1, 1, -1, 1] and image.origin == "lower"
    assert np.array_equal(image.get_array(), np.round(31 * far / far.max()))
