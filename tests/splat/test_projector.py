"""The projector of clouds: what it promises of any cloud, and its derivative."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.cameras import project
from posecore.splat import projector, render, to_voxels
from tests.splat.plain import plain_render
from tests.splat.test_volumes import SIZE, clouds

K = torch.tensor([[90.0, 2, 30.5], [0, 95, 20.0], [0, 0, 1]], dtype=torch.float64)
IMAGE = (64, 42)
GRID = (32, 21, 10)
SEEDS = st.integers(0, 10**6)


# Into the grid ------------------------------------------------------------------------------------


def test_columns_and_rows_are_those_of_the_image():
    points = torch.tensor([[0.02, -0.03, 0.7], [-0.1, 0.05, 0.9]], dtype=torch.float64)
    voxels = to_voxels(points, K, IMAGE, GRID, 0.8, 0.5)
    pixels = project(K, points)
    # A voxel is two pixels wide and high: the centre of the first is between pixels 0 and 1.
    torch.testing.assert_close(voxels[:, :2] * 2 + 0.5, pixels, rtol=0, atol=1e-12)
    expected = (points[:, 2] - 0.8) / 0.05 + 4.5
    torch.testing.assert_close(voxels[:, 2], expected, rtol=0, atol=1e-12)


def test_the_range_of_depth_is_filled_by_the_slices():
    points = torch.tensor([[0, 0, 0.55], [0, 0, 1.05]], dtype=torch.float64)
    z = to_voxels(points, K, IMAGE, GRID, 0.8, 0.5)[:, 2]
    assert z.tolist() == pytest.approx([-0.5, 9.5])  # the front of the first, the back of the last


def test_cameras_and_depths_of_each_cloud():
    points = torch.rand(2, 3, 4, 3, dtype=torch.float64) + 0.5
    cameras = K + torch.rand(2, 3, 1, 1, dtype=torch.float64) * torch.tensor(
        [[1.0, 0, 1], [0, 1, 1], [0, 0, 0]]
    )
    depths = torch.rand(2, 3, dtype=torch.float64) + 0.5
    found = to_voxels(points, cameras, IMAGE, GRID, depths, 0.5)
    for b in range(2):
        for j in range(3):
            alone = to_voxels(points[b, j], cameras[b, j], IMAGE, GRID, float(depths[b, j]), 0.5)
            torch.testing.assert_close(found[b, j], alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize("z", [0.0, -0.0, 0.0099, -0.7, -1e30])
def test_behind_the_camera_is_nowhere_and_has_no_gradient(z):
    points = torch.tensor([[0.1, 0.1, z], [0.01, 0.02, 0.8]], requires_grad=True)
    voxels = to_voxels(points, K, IMAGE, GRID, 0.8, 0.5)
    assert voxels.isfinite().all()
    pictures = render(voxels, GRID, intensities=torch.ones(2), sigma=0.7)
    alone = render(voxels[1:].detach(), GRID, intensities=torch.ones(1), sigma=0.7)
    torch.testing.assert_close(pictures.silhouette, alone.silhouette)
    (pictures.silhouette.square().sum() + pictures.intensity.square().sum()).backward()
    assert points.grad.isfinite().all()
    assert not points.grad[0].any() and points.grad[1].any()


def test_far_aside_and_just_before_the_camera():
    points = torch.tensor([[1e3, -1e3, 0.0101], [0, 0, 1e20]], requires_grad=True)
    pictures = render(to_voxels(points, K, IMAGE, GRID, 0.8, 0.5), GRID, sigma=0.7)
    pictures.silhouette.sum().backward()
    assert not pictures.silhouette.any() and not points.grad.any()


# Pictures -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sigma", "shaded", "factor"), [(0, True, 1), (0.7, False, 1), (0.5, True, 4), (0.5, False, 4)]
)
def test_the_derivative_is_that_of_finite_differences(sigma, shaded, factor):
    points, shades, scales = clouds(points=3, seed=3)
    with torch.no_grad():
        scales *= factor
        points[0, 1] = points[0, 0] + 0.011  # a cell with more than it can hold

    def pictures(points, scales, *shades):
        found = render(
            points, SIZE, intensities=shades[0] if shades else None, scale=scales, sigma=sigma
        )
        return found if shades else found.silhouette

    given = [points, scales] + [shades] * shaded
    assert torch.autograd.gradcheck(pictures, [value.requires_grad_() for value in given])


def test_the_derivative_through_the_camera():
    points = torch.rand(2, 5, 3, dtype=torch.float64) * 0.1 + torch.tensor([-0.05, -0.05, 0.75])

    def pictures(points):
        voxels = to_voxels(points, K, IMAGE, (12, 8, 6), 0.8, 0.3)
        return render(voxels, (12, 8, 6), scale=0.8, sigma=0.6).silhouette

    assert torch.autograd.gradcheck(pictures, [points.requires_grad_()])


@pytest.mark.parametrize("wanted", range(3))
def test_of_one_input_only(wanted):
    given = list(clouds())
    given[wanted].requires_grad_()
    pictures = render(given[0], SIZE, intensities=given[1], scale=given[2], sigma=0.7)
    assert pictures.silhouette.requires_grad
    (found,) = torch.autograd.grad(pictures.intensity.sum(), given[wanted])
    every = [value.detach().clone().requires_grad_() for value in given]
    pictures = render(every[0], SIZE, intensities=every[1], scale=every[2], sigma=0.7)
    expected = torch.autograd.grad(pictures.intensity.sum(), every)[wanted]
    assert torch.equal(found, expected) and expected.abs().max() > 1e-3


def test_it_has_no_second_derivative_and_says_so():
    points, _, _ = clouds()
    silhouette = render(points.requires_grad_(), SIZE, sigma=0.7).silhouette
    (slope,) = torch.autograd.grad(silhouette.sum(), points, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice|does not require grad"):
        slope.sum().backward()


def test_leading_dimensions_and_a_cloud_alone():
    """Which clouds are computed together changes nothing that counts."""
    points, shades, scales = clouds(6)
    batch = points.reshape(2, 3, 6, 3), shades.reshape(2, 3, 6), scales.reshape(2, 3)
    found = render(batch[0], SIZE, intensities=batch[1], scale=batch[2], sigma=0.8)
    assert found.silhouette.shape == found.intensity.shape == (2, 3, 7, 9)
    for k in range(6):
        alone = render(points[k], SIZE, intensities=shades[k], scale=scales[k], sigma=0.8)
        assert alone.silhouette.shape == (7, 9)
        for one, all_of_them in zip(alone, found, strict=True):
            torch.testing.assert_close(one, all_of_them.flatten(0, 1)[k], rtol=0, atol=1e-13)


def test_parts_are_the_whole(monkeypatch):
    points, shades, scales = clouds(5)

    def result():
        given = [value.clone().requires_grad_() for value in (points, shades, scales)]
        found = render(given[0], SIZE, intensities=given[1], scale=given[2], sigma=0.8)
        weights = torch.arange(found.silhouette.numel()).reshape(found.silhouette.shape) / 100
        total = (found.silhouette * weights).sum() - (found.intensity * weights).square().sum()
        return [*found, *torch.autograd.grad(total, given)]

    together = result()
    monkeypatch.setitem(projector.AT_ONCE, "cpu", 2 * 9 * 7 * 8)
    for one, other in zip(result(), together, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("batch", "count"), [((0,), 4), ((2,), 0), ((0, 3), 0), ((), 0)])
def test_no_clouds_and_no_points(batch, count):
    points = torch.zeros(*batch, count, 3, requires_grad=True)
    shades = torch.zeros(*batch, count, requires_grad=True)
    scales = torch.ones(batch, requires_grad=True)
    found = render(points, SIZE, intensities=shades, scale=scales, sigma=1.0)
    assert found.silhouette.shape == found.intensity.shape == (*batch, 7, 9)
    assert not found.silhouette.any()
    grads = torch.autograd.grad(found.silhouette.sum() + found.intensity.sum(), [points, scales])
    assert [g.shape for g in grads] == [points.shape, scales.shape]


def test_a_mask_without_anything_pulls_points_apart_or_out_and_is_finite():
    points = torch.rand(1, 30, 3) * torch.tensor(SIZE)
    points.requires_grad_()
    render(points, SIZE, sigma=1.0).silhouette.square().sum().backward()
    assert points.grad.isfinite().all() and points.grad.any()


@pytest.mark.parametrize("sigma", [0.0, 1.0])
@pytest.mark.parametrize("scale", [0.0, 1.0, 20.0])
def test_all_points_in_one_cell(scale, sigma):
    points = (torch.rand(1, 500, 3) + torch.tensor([3.0, 2, 4])).requires_grad_()
    shades = torch.rand(1, 500, requires_grad=True)
    scales = torch.full((1,), scale, requires_grad=True)
    found = render(points, SIZE, intensities=shades, scale=scales, sigma=sigma)
    assert found.silhouette.max() == 0 if scale == 0 else found.silhouette.max() > 0.5
    (found.silhouette.sum() + found.intensity.sum()).backward()
    for value in (points, shades, scales):
        assert value.grad.isfinite().all()
    assert scale > 0 or scales.grad > 0.1


def test_a_wall_of_full_voxels_is_dark_behind_and_finite():
    """All of the volume is full: 8 slices let 1e-40 of the light through, less than float32 has."""
    voxels = torch.cartesian_prod(*(torch.arange(float(n)) for n in SIZE)).requires_grad_()
    shades = torch.ones(len(voxels), requires_grad=True)
    found = render(voxels, SIZE, intensities=shades)
    torch.testing.assert_close(found.silhouette, torch.ones(7, 9))
    torch.testing.assert_close(found.intensity, torch.ones(7, 9))
    (found.silhouette.square().sum() + found.intensity.square().sum()).backward()
    assert voxels.grad.isfinite().all() and shades.grad.isfinite().all()
    front = voxels.detach()[:, 2] == 0
    assert (shades.grad[front] > 1.99).all() and (shades.grad[~front] < 1e-4).all()


@pytest.mark.parametrize("sigma", [0.0, 0.4, 3.0, 1000.0])
def test_float32_is_near_float64(sigma):
    points, shades, scales = clouds(points=200)
    given = [points, shades, scales]
    results = []
    for dtype in (torch.float64, torch.float32):
        # Rounded to float32 first, as a point on another side of a wall has other corners.
        p, c, s = (value.float().to(dtype).requires_grad_() for value in given)
        found = render(p, SIZE, intensities=c, scale=s, sigma=sigma)
        assert found.silhouette.dtype == found.intensity.dtype == dtype
        total = found.silhouette.sum() + found.intensity.sum()
        results.append([*found, *torch.autograd.grad(total, [p, c, s])])
    for exact, single in zip(*results, strict=True):
        torch.testing.assert_close(single.double(), exact, rtol=1e-4, atol=2e-5)


def test_half_precision_around_it_changes_nothing():
    points, shades, scales = clouds(dtype=torch.float32)

    def result():
        p = points.clone().requires_grad_()
        found = render(p, SIZE, intensities=shades.bfloat16(), scale=scales, sigma=0.8)
        return [*found, *torch.autograd.grad(found.silhouette.sum(), p)]

    plain = result()
    with torch.autocast("cpu", torch.bfloat16):
        for one, other in zip(result(), plain, strict=True):
            assert one.dtype == torch.float32 and torch.equal(one, other)


# What holds for any cloud -------------------------------------------------------------------------


@given(SEEDS, st.sampled_from([0.0, 0.5, 2.0]), st.integers(1, 40))
def test_shares_of_light(seed, sigma, count):
    points, shades, scales = clouds(points=count, seed=seed)
    found = render(points, SIZE, intensities=shades, scale=scales, sigma=sigma)
    assert (found.silhouette >= 0).all() and (found.silhouette <= 1).all()
    assert (found.intensity >= 0).all()
    assert (found.intensity <= found.silhouette + 1e-12).all()
    white = render(points, SIZE, intensities=torch.ones_like(shades), scale=scales, sigma=sigma)
    torch.testing.assert_close(white.intensity, white.silhouette, rtol=0, atol=1e-12)
    assert torch.equal(white.silhouette, found.silhouette)


@given(SEEDS, st.sampled_from([0.0, 0.5, 2.0]))
def test_the_order_of_points_does_not_matter(seed, sigma):
    points, shades, scales = clouds(points=20, seed=seed)
    order = torch.randperm(20, generator=torch.Generator().manual_seed(seed))
    one = render(points, SIZE, intensities=shades, scale=scales, sigma=sigma)
    other = render(points[:, order], SIZE, intensities=shades[:, order], scale=scales, sigma=sigma)
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12)


@given(SEEDS, st.sampled_from([0.0, 0.5, 1.0]))
def test_a_voxel_aside_is_a_pixel_aside(seed, sigma):
    """In a volume so large that nothing leaves it, and along the ray nothing changes."""
    rng = np.random.default_rng(seed)
    points = torch.from_numpy(rng.uniform(5, 10, (12, 3)))
    shades = torch.from_numpy(rng.uniform(size=12))
    options = {"intensities": shades, "scale": 0.9, "sigma": sigma}
    here = render(points, (16, 16, 16), **options)
    moved = render(points + torch.tensor([1.0, -1.0, 1.0]), (16, 16, 16), **options)
    for a, b in zip(here, moved, strict=True):
        assert a.max() > 0.01
        torch.testing.assert_close(a.roll((-1, 1), (0, 1)), b, rtol=0, atol=1e-12)


@given(SEEDS)
def test_more_points_hide_more(seed):
    points, _, _ = clouds(1, 20, seed)
    few = render(points[:, :10], SIZE, sigma=0.8).silhouette
    assert (render(points, SIZE, sigma=0.8).silhouette >= few - 1e-12).all()


def test_numbers_beside_tensors():
    points, shades, _ = clouds(1)
    found = render(points, SIZE, intensities=shades, scale=0.5, sigma=1)
    silhouette, picture = plain_render(points[0], SIZE, shades[0], 0.5, 1)
    torch.testing.assert_close(found.silhouette[0], silhouette, rtol=0, atol=1e-12)
    torch.testing.assert_close(found.intensity[0], picture, rtol=0, atol=1e-12)
    as_tensor = render(points, SIZE, intensities=shades, scale=torch.tensor([0.5]), sigma=1)
    assert torch.equal(as_tensor.silhouette, found.silhouette)


# What cannot be -----------------------------------------------------------------------------------

POINTS = torch.zeros(2, 5, 3)
BAD_POINTS = [
    np.zeros((5, 3)), torch.zeros(3), torch.zeros(5, 2), torch.zeros(5, 3, dtype=torch.int64),
    torch.full((5, 3), torch.nan), torch.full((5, 3), torch.inf), None,
]  # fmt: skip


@pytest.mark.parametrize("points", BAD_POINTS)
def test_what_are_no_points(points):
    with pytest.raises(ValueError, match="^points: expected"):
        render(points, SIZE)
    with pytest.raises(ValueError, match="^points: expected"):
        to_voxels(points, K, IMAGE, GRID, 0.8, 0.5)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("size", {"size": (9, 7)}),
        ("size", {"size": 9}),
        (r"size\[1\]", {"size": (9, 0, 8)}),
        (r"size\[2\]", {"size": (9, 7, 8.5)}),
        ("intensities", {"intensities": torch.zeros(2, 4)}),
        ("intensities", {"intensities": torch.zeros(5)}),
        ("intensities", {"intensities": 0.5}),
        ("intensities", {"intensities": torch.full((2, 5), torch.nan)}),
        ("scale", {"scale": torch.zeros(5)}),
        ("scale", {"scale": float("inf")}),
        ("scale", {"scale": -0.01}),
        ("scale", {"scale": torch.tensor([0.5, torch.nan])}),
        ("scale", {"scale": "one"}),
        ("scale", {"scale": None}),
        ("scale", {"scale": torch.tensor(1j)}),
        ("intensities", {"intensities": torch.ones(2, 5, dtype=torch.complex64)}),
        ("sigma", {"sigma": -1}),
        ("sigma", {"sigma": float("nan")}),
        ("sigma", {"sigma": 1001}),
    ],
)
def test_what_cannot_be_rendered(name, options):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        render(POINTS, **({"size": SIZE} | options))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("K", {"K": torch.eye(4)}),
        ("K", {"K": np.eye(3)}),
        ("image", {"image": (64,)}),
        (r"image\[0\]", {"image": (0, 42)}),
        ("size", {"size": (9, 7)}),
        ("depth", {"depth": torch.zeros(3)}),
        ("depth", {"depth": "near"}),
        ("depth", {"depth": None}),
        ("depth", {"depth": torch.tensor(1j)}),
        ("extent", {"extent": 0}),
        ("extent", {"extent": float("inf")}),
    ],
)
def test_what_cannot_be_a_grid(name, options):
    usual = {"K": K, "image": IMAGE, "size": GRID, "depth": 0.8, "extent": 0.5}
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        to_voxels(POINTS, **(usual | options))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_no_points_of_half_precision(dtype):
    """A full voxel would stop all light: gradients would be no numbers."""
    with pytest.raises(ValueError, match="^points: expected torch.float32 or torch.float64, got"):
        render(POINTS.to(dtype), SIZE)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="this needs a GPU")
def test_on_a_gpu_it_is_the_same():
    points, shades, scales = clouds()
    here = render(points, SIZE, intensities=shades, scale=scales, sigma=0.8)
    there = render(points.cuda(), SIZE, intensities=shades.cuda(), scale=scales.cuda(), sigma=0.8)
    for one, other in zip(here, there, strict=True):
        torch.testing.assert_close(one, other.cpu(), rtol=0, atol=1e-12)
