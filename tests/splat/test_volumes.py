"""Points as a blurred volume, and the way back: against the same written plainly."""

import math

import numpy as np
import pytest
import torch

from posecore.splat.volumes import MOST, kernel, rendered
from tests.splat.plain import blurred, plain_render

SIZE = (9, 7, 8)


def clouds(count=2, points=6, seed=0, dtype=torch.float64):
    """Points in SIZE and around it, with intensities and scales."""
    generator = torch.Generator().manual_seed(seed)
    places = torch.rand(count, points, 3, generator=generator, dtype=dtype)
    places = places * (torch.tensor(SIZE) + 1) - 1
    shades = torch.rand(count, points, generator=generator, dtype=dtype)
    scales = 0.3 + 0.7 * torch.rand(count, generator=generator, dtype=dtype)
    return places, shades, scales


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0, 2.7, 40.0])
def test_the_kernel_is_a_gaussian_that_sums_to_one(sigma):
    half = np.array(kernel(sigma))
    assert len(half) == math.ceil(3 * sigma) + 1
    assert math.isclose(half[0] + 2 * half[1:].sum(), 1)
    np.testing.assert_allclose(
        np.log(half / half[0]), -0.5 * (np.arange(len(half)) / sigma) ** 2, atol=1e-12
    )
    assert kernel(0) == (1.0,)


def test_a_kernel_as_narrow_as_none():
    assert kernel(1e-3) == (1.0, 0.0)
    assert kernel(1e-300) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("sigma", "factor"), [(0, 1), (0.6, 1), (1.5, 1), (30, 1), (0, 2.5), (0.4, 3), (0.6, 1.5)]
)
def test_values_and_gradients_are_those_of_loops(sigma, factor):
    """A sigma of 30 reaches further than the volume; scales times a factor fill some voxels."""
    points, shades, scales = (value.requires_grad_() for value in clouds())
    with torch.no_grad():
        scales *= factor
        points[0, 0] = torch.tensor([20.0, 2, 2])  # outside
        points[0, 1] = points[0, 2] + 0.01  # in one cell, which is full
        points[0, 3] = points[0, 2] + 0.02
    pictures, back = rendered(points.detach(), shades.detach(), scales.detach(), SIZE, sigma)
    weights = torch.rand(2, 2, SIZE[1], SIZE[0], dtype=torch.float64)
    total = 0.0
    for b in range(2):
        silhouette, picture = plain_render(points[b], SIZE, shades[b], scales[b], sigma)
        torch.testing.assert_close(pictures.silhouette[b], silhouette, rtol=1e-8, atol=1e-13)
        torch.testing.assert_close(pictures.intensity[b], picture, rtol=1e-8, atol=1e-13)
        total = total + (silhouette * weights[0, b]).sum() + (picture * weights[1, b]).sum()
    expected = torch.autograd.grad(total, [points, shades, scales])
    found = back(weights[0], weights[1])
    for one, other in zip(found, expected, strict=True):
        assert other.any()
        torch.testing.assert_close(one, other, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("factor", [1, 8])
def test_without_intensities_it_is_the_same_silhouette(factor):
    points, shades, scales = clouds()
    scales *= factor
    with_them, _ = rendered(points, shades, scales, SIZE, 0.8)
    without, back = rendered(points, None, scales, SIZE, 0.8)
    assert without.intensity is None
    torch.testing.assert_close(without.silhouette, with_them.silhouette, rtol=0, atol=1e-13)
    found = back(torch.ones_like(without.silhouette), None)
    assert found.intensities is None
    points.requires_grad_(), scales.requires_grad_()
    total = sum(
        plain_render(p, SIZE, scale=s, sigma=0.8)[0].sum()
        for p, s in zip(points, scales, strict=True)
    )
    expected = torch.autograd.grad(total, [points, scales])
    torch.testing.assert_close(found.points, expected[0], rtol=0, atol=1e-11)
    torch.testing.assert_close(found.scales, expected[1], rtol=0, atol=1e-11)


def test_the_way_back_can_be_gone_twice():
    points, shades, scales = clouds()
    pictures, back = rendered(points, shades, scales, SIZE, 0.8)
    before = points.clone(), shades.clone(), scales.clone()
    ones = torch.ones_like(pictures.silhouette)
    first, second = back(ones, ones), back(ones, ones)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert all(torch.equal(a, b) for a, b in zip((points, shades, scales), before, strict=True))


def test_one_point_in_the_middle_of_a_voxel():
    points = torch.tensor([[[3.0, 2, 4]]], dtype=torch.float64)
    one = torch.ones(1, dtype=torch.float64)
    pictures, _ = rendered(points, torch.tensor([[0.25]], dtype=torch.float64), one, SIZE, 0.0)
    expected = torch.zeros(SIZE[1], SIZE[0], dtype=torch.float64)
    expected[2, 3] = MOST
    torch.testing.assert_close(pictures.silhouette[0], expected)
    torch.testing.assert_close(pictures.intensity[0], 0.25 * expected)


def test_one_point_between_voxels_is_shared_by_their_distances():
    points = torch.tensor([[[3.25, 2.5, 4]]], dtype=torch.float64)
    pictures, _ = rendered(points, None, torch.ones(1, dtype=torch.float64), SIZE, 0.0)
    window = pictures.silhouette[0, 2:4, 3:5] / MOST
    expected = torch.tensor([[0.375, 0.125], [0.375, 0.125]], dtype=torch.float64)
    torch.testing.assert_close(window, expected)
    assert pictures.silhouette.count_nonzero() == 4


def test_the_first_of_two_full_voxels_stops_the_ray():
    points = torch.tensor([[[3.0, 2, 5], [3, 2, 1]]], dtype=torch.float64)
    shades = torch.tensor([[1.0, 0.5]], dtype=torch.float64)
    ones = torch.ones(1, dtype=torch.float64)
    pictures, back = rendered(points, shades, ones, SIZE, 0.0)
    assert pictures.intensity[0, 2, 3].item() == pytest.approx(0.5, abs=2e-5)
    upon = torch.ones_like(pictures.silhouette)
    found = back(torch.zeros_like(upon), upon)
    assert found.intensities[0].tolist() == pytest.approx([0, 1], abs=2e-5)


def test_a_blur_loses_what_leaves_the_volume_and_nothing_else():
    """At a scale that is small rays stop little, and the silhouette is the sum along them."""
    for place, inside in (([4.0, 3, 4], True), ([0.0, 3, 4], False)):
        points = torch.tensor([[place]], dtype=torch.float64)
        small = torch.tensor([1e-6], dtype=torch.float64)
        pictures, _ = rendered(points, None, small, SIZE, 0.9)
        total = float(pictures.silhouette.sum()) / 1e-6 / MOST
        assert math.isclose(total, 1, rel_tol=1e-5) == inside
        volume = torch.zeros(SIZE[::-1], dtype=torch.float64)
        volume[tuple(int(value) for value in reversed(place))] = 1
        assert math.isclose(total, float(blurred(volume, 0.9).sum()), rel_tol=1e-5)


@pytest.mark.parametrize("place", [[-5.0, 2, 2], [3, 2, 8.5], [3, 40, 2], [-1e4] * 3, [1e30] * 3])
def test_nothing_in_the_volume_is_black_and_has_no_influence(place):
    points = torch.tensor([[place, place]], dtype=torch.float32)
    shades, scales = torch.ones(1, 2), torch.ones(1)
    pictures, back = rendered(points, shades, scales, SIZE, 1.5)
    assert not pictures.silhouette.any() and not pictures.intensity.any()
    ones = torch.ones(1, SIZE[1], SIZE[0])
    found = back(ones, ones)
    assert [value.shape for value in found] == [points.shape, shades.shape, scales.shape]
    assert not any(value.any() for value in found)


def test_a_cloud_without_points_is_black():
    points, shades, scales = torch.zeros(2, 0, 3), torch.zeros(2, 0), torch.ones(2)
    for given in (shades, None):
        pictures, back = rendered(points, given, scales, SIZE, 1.0)
        assert pictures.silhouette.shape == (2, 7, 9) and not pictures.silhouette.any()
        ones = torch.ones(2, 7, 9)
        found = back(ones, None if given is None else ones)
        assert found.points.shape == (2, 0, 3)
        assert found.scales.tolist() == [0, 0]


def test_points_at_the_walls():
    """Half outside by half a voxel; a whole voxel outside nothing is left."""
    one = torch.ones(1, dtype=torch.float64)
    for x, share in ((-0.5, 0.5), (-0.75, 0.25), (-1.0, 0), (8.0, 1), (8.25, 0.75), (9.0, 0)):
        points = torch.tensor([[[x, 2.0, 4.0]]], dtype=torch.float64)
        pictures, _ = rendered(points, None, one, SIZE, 0.0)
        assert float(pictures.silhouette.sum()) == pytest.approx(share * MOST)
