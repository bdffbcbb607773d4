"""Cameras: against OpenCV, against images with a drawn spot, and back and forth."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore import cameras

WIDTH, HEIGHT = 96, 72
K = np.array([[110.0, 0, 46.3], [0, 104, 33.8], [0, 0, 1]])
SKEWED = np.array([[110.0, 3.5, 46.3], [0, -104, 33.8], [0, 0, 1]])

seeds = st.integers(0, 2**32 - 1)


def random_camera(rng, *batch):
    matrix = np.zeros((*batch, 3, 3))
    matrix[..., 0, 0] = rng.uniform(50, 900, batch)
    matrix[..., 1, 1] = rng.uniform(50, 900, batch) * rng.choice([-1, 1], batch)
    matrix[..., 0, 1] = rng.normal(scale=5, size=batch)
    matrix[..., :2, 2] = rng.uniform(-100, 700, (*batch, 2))
    matrix[..., 2, 2] = 1
    return matrix


def random_points(rng, *shape):
    return rng.normal(size=(*shape, 3)) + [0, 0, 5] + [0, 0, 1] * rng.exponential(size=(*shape, 1))


# Projection


@given(seeds)
def test_project_agrees_with_opencv(seed):
    rng = np.random.default_rng(seed)
    matrix = random_camera(rng)
    matrix[0, 1] = 0  # OpenCV knows no skew
    points = np.abs(random_points(rng, 20)) + 0.1
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, None)[0][:, 0]
    np.testing.assert_allclose(cameras.project(matrix, points), expected, rtol=1e-12, atol=1e-9)


def test_project_is_the_homogeneous_product_with_skew_and_batches(rng):
    matrices, points = random_camera(rng, 4, 1), np.abs(random_points(rng, 3, 7)) + 0.1
    pixels = cameras.project(matrices, points)
    assert pixels.shape == (4, 3, 7, 2)
    for i, j, n in np.ndindex(4, 3, 7):
        x, y, z = matrices[i, 0] @ points[j, n]
        np.testing.assert_allclose(pixels[i, j, n], [x / z, y / z], rtol=1e-12, atol=1e-10)


def test_project_depends_on_the_ray_only(rng):
    points = np.abs(random_points(rng, 5)) + 0.1
    np.testing.assert_allclose(
        cameras.project(K, 1e6 * points), cameras.project(K, points), rtol=1e-12
    )


@pytest.mark.parametrize("z", [0.0, -1e-30, -2.0])
def test_points_behind_the_camera_are_refused_or_infinitely_far(z):
    points = torch.tensor([[0.1, 0.2, 1.0], [0.1, 0.2, z], [0.0, 0.0, z]], dtype=torch.float64)
    with pytest.raises(ValueError, match=r"points: .*2 of 3 with z <= 0"):
        cameras.project(K, points)
    points.requires_grad_()
    pixels = cameras.project(torch.from_numpy(K), points, behind="inf")
    assert torch.isinf(pixels[1:]).all() and (pixels[1:] > 0).all()
    pixels[0].sum().backward()
    assert torch.isfinite(points.grad).all()
    torch.testing.assert_close(points.grad[1:], torch.zeros(2, 3, dtype=torch.float64))
    assert (points.grad[0] != 0).all()


def test_a_point_on_the_edge_of_the_half_space_never_gives_nan():
    points = np.array([[0.0, 0, 5e-324], [1, 0, 5e-324], [0, -1, 5e-324]])
    with np.errstate(over="ignore"):
        assert not np.isnan(cameras.project(SKEWED, points)).any()


def test_project_passes_exact_gradients(rng):
    matrix = torch.from_numpy(random_camera(rng)).requires_grad_()
    points = torch.from_numpy(np.abs(random_points(rng, 4)) + 0.5).requires_grad_()

    def pixels(fx, points):
        changed = matrix.clone()
        changed[0, 0] = fx
        return cameras.project(changed, points)

    assert torch.autograd.gradcheck(pixels, (matrix[0, 0].detach().requires_grad_(), points))


# Depth images


@given(seeds)
def test_back_projected_pixels_project_to_themselves(seed):
    rng = np.random.default_rng(seed)
    matrix, depth = random_camera(rng), rng.uniform(0.2, 3, (5, 7))
    points = cameras.back_project(depth, matrix)
    np.testing.assert_array_equal(points[..., 2], depth)
    pixels = cameras.project(matrix, points.reshape(-1, 3)).reshape(5, 7, 2)
    rows, columns = np.mgrid[:5, :7]
    # A skewed ray is a difference of terms of up to 700 pixels: 1e-12 of that is left.
    np.testing.assert_allclose(pixels, np.stack([columns, rows], -1), atol=1e-9)


def test_back_project_takes_batches_and_leaves_unknown_depth_at_the_origin(rng):
    matrices, depth = random_camera(rng, 3), rng.uniform(0.5, 2, (2, 1, 4, 6))
    depth[0, 0, 1, 2] = 0
    points = cameras.back_project(depth, matrices)
    assert points.shape == (2, 3, 4, 6, 3)
    np.testing.assert_array_equal(points[0, :, 1, 2], np.zeros((3, 3)))
    for i, j, row, column in np.ndindex(2, 3, 4, 6):
        ray = np.linalg.solve(matrices[j], [column, row, 1])
        expected = depth[i, 0, row, column] * ray
        np.testing.assert_allclose(points[i, j, row, column], expected, rtol=1e-10, atol=1e-12)


@given(seeds, st.booleans())
def test_depth_to_points_are_the_valid_pixels_row_by_row(seed, with_mask):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 2, (6, 5)) * (rng.uniform(size=(6, 5)) > 0.4)
    depth[3, 2] = 1
    mask = rng.uniform(size=(6, 5)) > 0.3
    mask[3, 2] = True
    wanted = (depth > 0) & mask if with_mask else depth > 0
    points = cameras.depth_to_points(depth, SKEWED, mask if with_mask else None)
    np.testing.assert_allclose(points, cameras.back_project(depth, SKEWED)[wanted], rtol=1e-14)


@pytest.mark.parametrize("kind", [bool, np.uint8, np.float32, torch.tensor, np.ndarray.tolist])
def test_a_mask_of_any_kind_selects_the_same_points(kind):
    depth, mask = np.full((2, 3), 2, dtype=np.float32), np.array([[1, 0, 0], [0, 1, 0]])
    given_mask = kind(mask) if kind in (torch.tensor, np.ndarray.tolist) else mask.astype(kind)
    points = cameras.depth_to_points(depth, K.astype(np.float32), given_mask)
    assert points.dtype == np.float32 and points.shape == (2, 3)


# Crops and resized images: the camera must see a drawn spot where it is


def draw_spot(pixel, width=WIDTH, height=HEIGHT, sigma=3.0):
    rows, columns = np.mgrid[:height, :width]
    return np.exp(-((columns - pixel[0]) ** 2 + (rows - pixel[1]) ** 2) / (2 * sigma**2))


def centroid(image):
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()


POINT = np.array([[0.11, -0.05, 1.3]])
SPOT = cameras.project(K, POINT)[0]


def test_the_spot_is_drawn_where_the_camera_sees_it():
    np.testing.assert_allclose(centroid(draw_spot(SPOT)), SPOT, atol=1e-6)


def test_crop_sees_the_spot_in_the_sliced_image():
    cropped = draw_spot(SPOT)[10:60, 25:]
    pixel = cameras.project(cameras.crop_intrinsics(K, 25, 10), POINT)[0]
    np.testing.assert_allclose(centroid(cropped), pixel, atol=1e-6)


@pytest.mark.parametrize("new_size", [(48, 36), (32, 24), (192, 144), (150, 50), (96, 72)])
def test_resize_sees_the_spot_in_the_image_of_cv2_resize(new_size):
    shrinks = new_size[0] < WIDTH
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    resized = cv2.resize(draw_spot(SPOT), new_size, interpolation=method)
    new_K = cameras.resize_intrinsics(K, (WIDTH, HEIGHT), new_size)
    pixel = cameras.project(new_K, POINT)[0]
    # Interpolation blurs a little; the convention without the half pixels is off by 0.15 or more.
    np.testing.assert_allclose(centroid(resized), pixel, atol=0.01)


@pytest.mark.parametrize(
    ("box", "new_size"),
    [
        ((25, 10, 60, 45), (120, 90)),
        ((21.7, 3.25, 66.5, 61.1), (96, 80)),
        ((0, 0, 96, 72), (96, 72)),
    ],
)
def test_crop_and_resize_sees_the_spot_in_the_image_of_cv2_warp_affine(box, new_size):
    x, y, width, height = box
    scale = np.array([new_size[0] / width, new_size[1] / height])
    # Old borders (half a pixel outside the centres) to new borders, written as OpenCV wants it.
    warp = np.column_stack([np.diag(scale), (0.5 - np.array([x, y])) * scale - 0.5])
    warped = cv2.warpAffine(draw_spot(SPOT), warp, new_size)
    pixel = cameras.project(cameras.crop_and_resize_intrinsics(K, box, new_size), POINT)[0]
    np.testing.assert_allclose(centroid(warped), pixel, atol=0.01)


@given(seeds)
def test_crop_and_resize_is_a_crop_and_then_a_resize(seed):
    rng = np.random.default_rng(seed)
    matrix, (x, y) = random_camera(rng), rng.integers(-50, 50, 2)
    size, new_size = (tuple(rng.integers(1, 200, 2)) for _ in range(2))
    expected = cameras.resize_intrinsics(cameras.crop_intrinsics(matrix, x, y), size, new_size)
    result = cameras.crop_and_resize_intrinsics(matrix, (x, y, *size), new_size)
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(result[2], [0, 0, 1])
    back = cameras.resize_intrinsics(result, new_size, size)
    np.testing.assert_allclose(cameras.crop_intrinsics(back, -x, -y), matrix, atol=1e-9)


def test_a_pixel_moves_by_the_stated_formula(rng):
    points, old, new = np.abs(random_points(rng, 9)) + 0.1, (640, 480), (224, 100)
    before = cameras.project(SKEWED, points)
    after = cameras.project(cameras.resize_intrinsics(SKEWED, old, new), points)
    np.testing.assert_allclose(after, (before + 0.5) * np.divide(new, old) - 0.5, atol=1e-10)
    shifted = cameras.project(cameras.crop_intrinsics(SKEWED, 12.5, -3), points)
    np.testing.assert_allclose(shifted, before - [12.5, -3], atol=1e-10)


def test_every_image_of_a_batch_may_have_its_own_box(rng):
    matrices, boxes = random_camera(rng, 4), rng.uniform(5, 50, (3, 1, 4))
    result = cameras.crop_and_resize_intrinsics(matrices, boxes, (64, 64))
    assert result.shape == (3, 4, 3, 3)
    for i, j in np.ndindex(3, 4):
        single = cameras.crop_and_resize_intrinsics(matrices[j], boxes[i, 0], (64, 64))
        np.testing.assert_allclose(result[i, j], single, rtol=1e-15)
    shifts = rng.uniform(-5, 5, (2, 4))
    result = cameras.crop_intrinsics(matrices, *shifts)
    np.testing.assert_allclose(result[..., :2, 2], matrices[..., :2, 2] - shifts.T, atol=1e-12)


def test_gradients_reach_the_box():
    box = torch.tensor([21.7, 3.2, 66.5, 61.1], dtype=torch.float64, requires_grad=True)
    matrix = torch.from_numpy(SKEWED)
    assert torch.autograd.gradcheck(
        lambda box: cameras.crop_and_resize_intrinsics(matrix, box, (64, 48)), box
    )


def test_plain_numbers_leave_the_precision_alone():
    single = torch.from_numpy(K).float()
    for result in (
        cameras.crop_intrinsics(single, 3, 4.5),
        cameras.crop_and_resize_intrinsics(single, (1, 2, 3, 4), (5, 6)),
        cameras.resize_intrinsics(single, (10, 20), (5, 10)),
    ):
        assert isinstance(result, torch.Tensor) and result.dtype == torch.float32


@given(seeds)
def test_require_intrinsics_lets_every_pinhole_camera_pass(seed):
    rng = np.random.default_rng(seed)
    matrices = random_camera(rng, 2, 3)
    assert cameras.require_intrinsics("K", matrices) is None
    row, column = [(0, 0), (1, 1), (1, 0), (2, 0), (2, 1), (2, 2)][rng.integers(6)]
    matrices[1, 2, row, column] = 0 if row == column else 1e-3
    with pytest.raises(ValueError, match=r"K_left: .*fx and fy not 0"):
        cameras.require_intrinsics("K_left", torch.from_numpy(matrices))


BAD_K = np.diag([100.0, 100, 2])
DEPTH = np.ones((4, 5))
BAD_CALLS = [
    (lambda: cameras.project(BAD_K, POINT), "K"),
    (lambda: cameras.project(K, -POINT), "points"),
    (lambda: cameras.project(K, POINT, behind="clip"), "behind"),
    (lambda: cameras.back_project(-DEPTH, K), "depth"),
    (lambda: cameras.back_project(DEPTH, BAD_K), "K"),
    (lambda: cameras.depth_to_points(-DEPTH, K), "depth"),
    (lambda: cameras.depth_to_points(0 * DEPTH, K), "depth"),
    (lambda: cameras.depth_to_points(DEPTH, BAD_K), "K"),
    (lambda: cameras.depth_to_points(DEPTH, K, DEPTH[:3] > 0), "mask"),
    (lambda: cameras.depth_to_points(DEPTH, K, DEPTH < 0), "mask"),
    (lambda: cameras.crop_intrinsics(BAD_K, 1, 2), "K"),
    (lambda: cameras.crop_intrinsics(np.stack([K, K]), [1, 2, 3], 0), "K and the crop"),
    (lambda: cameras.crop_intrinsics(K, np.inf, 2), "x"),
    (lambda: cameras.crop_intrinsics(K, 1, "two"), "y"),
    (lambda: cameras.resize_intrinsics(BAD_K, (4, 3), (2, 1)), "K"),
    (lambda: cameras.resize_intrinsics(K, (0, 3), (2, 1)), "old_size"),
    (lambda: cameras.resize_intrinsics(K, (4, 3), (2.5, 1)), "new_size"),
    (lambda: cameras.resize_intrinsics(K, (4, 3), (2, 1, 3)), "new_size"),
    (lambda: cameras.resize_intrinsics(K, 4, (2, 1)), "old_size"),
    (lambda: cameras.crop_and_resize_intrinsics(K, (1, 2, 0, 4), (8, 8)), "box"),
    (lambda: cameras.crop_and_resize_intrinsics(K, (1, 2, 3), (8, 8)), "box"),
    (lambda: cameras.crop_and_resize_intrinsics(K, (1, 2, 3, np.nan), (8, 8)), "box"),
    (lambda: cameras.crop_and_resize_intrinsics(K, (1, 2, 3, 4), (8, -8)), "new_size"),
    (lambda: cameras.require_intrinsics("K", K[0]), "K"),
    (lambda: cameras.require_intrinsics("K", K * np.nan), "K"),
    (lambda: cameras.require_intrinsics("K", [[1, 2], [3]]), "K"),
]


@pytest.mark.parametrize(("call", "argument"), BAD_CALLS)
def test_bad_input_is_refused_by_name(call, argument):
    with pytest.raises(ValueError, match=rf"^{argument}: expected .*got"):
        call()
