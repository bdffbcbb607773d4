"""Lenses: against OpenCV, back and forth, at the rim and beyond it."""

import cv2
import numpy as np
import pytest
import torch

from posecore import cameras
from posecore.distortion import distort_points, project_distorted, undistort_points

K = np.array([[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]])
SKEWED = K + [[0, 3.0, 0], [0, 0, 0], [0, 0, 0]]
# A webcam, a wide lens that bends much, a telephoto lens with a cushion, a rational model.
LENSES = {
    "webcam": [0.08, -0.21, 0.0011, -0.0007, 0.05],
    "wide": [-0.31, 0.12, 0.0004, 0.0011, -0.021],
    "barrel": [-0.28, 0.0, 0.001, -0.002],
    "cushion": [0.25, 0.1, -0.001, 0.002],
    "rational": [0.9, -0.4, 0.0002, -0.0003, 0.05, 1.2, -0.1, 0.02],
}
lenses = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
BARREL_RIM = 1 / np.sqrt(3 * 0.28)  # where d(r - 0.28 r^3) / dr = 0, without p1 and p2


def pixels(seed, count=20):
    return np.random.default_rng(seed).uniform([0, 0], [640, 480], (count, 2))


def bent_radius(lens, radii):
    """Of rays along x, for coefficients (8,) without p1 and p2; and the denominator."""
    k1, k2, _, _, k3, k4, k5, k6 = lens
    s = radii**2
    below = 1 + s * (k4 + s * (k5 + s * k6))
    return radii * (1 + s * (k1 + s * (k2 + s * k3))) / below, below


# Against OpenCV -----------------------------------------------------------------------------------


@lenses
def test_projection_like_opencv(lens, rng):
    points = np.column_stack([rng.uniform(-0.45, 0.45, (1000, 2)), np.ones(1000)])
    points *= rng.uniform(0.1, 3, (1000, 1))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(lens))[0][:, 0]
    found = project_distorted(K, points, lens)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    again = distort_points(cameras.project(K, points), K, lens)
    np.testing.assert_allclose(again, expected, rtol=0, atol=1e-10)


@lenses
def test_undistorted_like_opencv(lens):
    """With enough of its iterations."""
    seen = pixels(0, 500)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    expected = cv2.undistortPoints(seen[:, None], K, np.array(lens), None, None, K, stop)[:, 0]
    np.testing.assert_allclose(undistort_points(seen, K, lens), expected, rtol=0, atol=1e-8)


# Back and forth -----------------------------------------------------------------------------------


@lenses
def test_there_and_back(lens):
    seen = pixels(1, 2000)
    for camera in (K, SKEWED):
        straight = undistort_points(seen, camera, lens)
        np.testing.assert_allclose(distort_points(straight, camera, lens), seen, atol=1e-10)
        bent = distort_points(straight, camera, lens)
        np.testing.assert_allclose(undistort_points(bent, camera, lens), straight, atol=1e-9)


def test_no_distortion_is_the_pinhole_camera(rng):
    points = rng.normal(size=(2, 9, 3)) + [0, 0, 5]
    for zeros in (np.zeros(4), np.zeros(5), np.zeros(8)):
        expected = cameras.project(SKEWED, points)
        np.testing.assert_allclose(project_distorted(SKEWED, points, zeros), expected, atol=1e-12)
        for same in (distort_points, undistort_points):
            np.testing.assert_allclose(same(expected, SKEWED, zeros), expected, atol=1e-12)


def test_by_hand():
    eye = np.eye(3)
    found = distort_points([[0.5, 0.25]], eye, [0.1, 0.2, 0.01, 0.02])
    s = 0.3125
    f = 1 + 0.1 * s + 0.2 * s**2
    x = 0.5 * f + 2 * 0.01 * 0.125 + 0.02 * (s + 0.5)
    y = 0.25 * f + 0.01 * (s + 0.125) + 2 * 0.02 * 0.125
    np.testing.assert_allclose(found, [[x, y]], rtol=1e-15)
    found = distort_points([[1.0, 0]], eye, [1, 1, 0, 0, 1, 0.5, 0.25, 0.25])
    np.testing.assert_allclose(found, [[2, 0]], rtol=1e-15)


# At the rim and beyond ----------------------------------------------------------------------------


@pytest.mark.parametrize("lens", [[-0.28, 0, 0, 0], [-0.28, 0, 0, 0, 0, 0, 0, 0]])
def test_beyond_the_rim_nothing_is_seen(lens):
    """OpenCV draws it into the picture, on top of what is there."""
    eye, inside, outside = np.eye(3), 0.999 * BARREL_RIM, 1.001 * BARREL_RIM
    seen = distort_points([[inside, 0]], eye, lens)
    np.testing.assert_allclose(undistort_points(seen, eye, lens), [[inside, 0]], atol=1e-9)
    with pytest.raises(
        ValueError, match="^points: expected points that the lens can see, got 1 of"
    ):
        distort_points([[inside, 0], [0, outside]], eye, lens)
    found = distort_points([[inside, 0], [0, outside]], eye, lens, beyond="inf")
    assert np.array_equal(found, [seen[0], [np.inf, np.inf]])
    rays = np.array([[0, outside, 1], [0, 0.1, 1], [0, 0.1, -1], [0, 9e99, 1e-99]])
    with pytest.raises(
        ValueError, match="^points: expected points that the lens can see, got 2 of"
    ):
        project_distorted(K, rays[[0, 1, 3]], lens)
    with pytest.raises(ValueError, match="^points: expected z > 0 everywhere, got 1 of 4"):
        project_distorted(K, rays, lens)
    found = project_distorted(K, rays, lens, behind="inf")
    assert np.isfinite(found).all(-1).tolist() == [False, True, False, False]
    assert (found[[0, 2, 3]] == np.inf).all()


@pytest.mark.parametrize("lens", [[-0.28, 0, 0, 0], LENSES["barrel"]])
def test_pixels_to_which_no_ray_leads(lens):
    """The farthest that a barrel shows is 2/3 of its rim; outside, its corners are black."""
    radius = 2 / 3 * BARREL_RIM
    near, far = 0.98 * radius, 1.02 * radius
    points = [[near, 0], [far, 0], [0, near], [0, -far]]
    with pytest.raises(ValueError, match=r"^points: expected pixels to which a ray .*, got 2 of 4"):
        undistort_points(points, np.eye(3), lens)
    found = undistort_points(points, np.eye(3), lens, beyond="inf")
    assert (found[[1, 3]] == np.inf).all()
    again = distort_points(found[[0, 2]], np.eye(3), lens)
    np.testing.assert_allclose(again, [[near, 0], [0, near]], atol=1e-12)


@pytest.mark.parametrize("count", [4, 5, 8])
def test_any_coefficients_give_the_ray_or_none(count, rng):
    """Compared with a plain search along the radius, where the lens is round."""
    lenses = rng.normal(scale=0.5, size=(100, count))
    lenses[:, 2:4] = 0
    wanted, angle = rng.uniform(0, 2, (100, 20)), rng.uniform(0, 2 * np.pi, (100, 20))
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    rays = undistort_points(wanted[..., None] * direction, np.eye(3), lenses, beyond="inf")
    there = np.isfinite(rays).all(-1)
    assert 0.2 < there.mean() < 0.9
    radii = np.linspace(0, 20, 20001)
    for i, lens in enumerate(lenses):
        bent, below = bent_radius(np.pad(lens, (0, 8 - count)), radii)
        stops = (np.diff(bent) <= 0) | (below[1:] <= 0)
        end = int(np.argmax(stops)) if stops.any() else len(stops)
        inside = wanted[i] < bent[end]
        if end < len(stops):  # else the ray may be farther out than what was searched
            clear = np.abs(wanted[i] - bent[end]) > 1e-3 * (1 + np.abs(bent[end]))
            assert (there[i] == inside)[clear].all()
        expected = np.interp(wanted[i], bent[: end + 1], radii[: end + 1])
        sure = there[i] & inside & (expected < 0.98 * radii[end])
        found = rays[i, sure]
        np.testing.assert_allclose(found, expected[sure, None] * direction[i, sure], atol=2e-4)


def test_a_pole_is_an_end():
    lens = [0, 0, 0, 0, 0, -1.0, 0, 0]  # r / (1 - r^2): infinite at 1
    assert np.isfinite(distort_points([[0.999, 0]], np.eye(3), lens)).all()
    assert (distort_points([[1.001, 0]], np.eye(3), lens, beyond="inf") == np.inf).all()
    far = undistort_points([[1e4, 0]], np.eye(3), lens)
    r = far[0, 0]
    assert 0 < r < 1 and r / (1 - r * r) == pytest.approx(1e4)


# Batches, precision, gradients --------------------------------------------------------------------


def test_every_camera_has_a_lens_of_its_own():
    cameras_and_lenses = [(K, LENSES["wide"]), (SKEWED, LENSES["webcam"])]
    seen = np.stack([pixels(1), pixels(2), pixels(3)])[:, None]
    lens = np.array([lens for _, lens in cameras_and_lenses])
    found = undistort_points(seen, np.stack([K, SKEWED]), lens)
    assert found.shape == (3, 2, 20, 2)
    for i, j in np.ndindex(3, 2):
        one = undistort_points(seen[i, 0], *cameras_and_lenses[j])
        np.testing.assert_allclose(found[i, j], one, atol=1e-12)


def test_single_precision():
    seen = pixels(0).astype(np.float32)
    lens, camera = np.array(LENSES["wide"], np.float32), K.astype(np.float32)
    found = undistort_points(seen, camera, lens)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, undistort_points(pixels(0), K, lens), rtol=0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("lens", [LENSES["barrel"], LENSES["rational"]])
def test_gradients(lens):
    points = torch.tensor([[[0.1, 0.2, 1.0], [-0.3, 0.1, 0.9]]], dtype=torch.float64)
    seen = torch.from_numpy(pixels(0, 3))
    arguments = [torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in (K, lens)]
    points.requires_grad_()
    seen.requires_grad_()

    def camera(K):  # of which the last row stays
        return torch.cat(
            [torch.tensor([[1.0, 1, 1], [0, 1, 1]]) * K[:2], torch.eye(3)[2:].double()]
        )

    assert torch.autograd.gradcheck(
        lambda K, p, d: project_distorted(camera(K), p, d), (arguments[0], points, arguments[1])
    )
    for function in (distort_points, undistort_points):
        assert torch.autograd.gradcheck(
            lambda x, K, d, function=function: function(x, camera(K), d),
            (seen, *arguments),
            atol=1e-4,
            rtol=1e-6,
        )


def test_what_is_infinite_passes_no_gradient():
    points = torch.tensor(
        [[0, 0.2, 1.0], [0, 5, 1], [0, 1, -1], [0, 1e99, 1e-99]], dtype=torch.float64
    ).requires_grad_()
    lens = torch.tensor([-0.28, 0, 0.001, 0], dtype=torch.float64, requires_grad=True)
    found = project_distorted(torch.from_numpy(K), points, lens, behind="inf")
    gradients = torch.autograd.grad(found[found.isfinite()].sum(), (points, lens))
    assert (gradients[0][1:] == 0).all() and (gradients[0][0] != 0).any()
    assert gradients[1].isfinite().all()
    seen = torch.tensor([[0.1, 0.2], [3, 3]], dtype=torch.float64, requires_grad=True)
    found = undistort_points(seen, np.eye(3), lens, beyond="inf")
    (gradient,) = torch.autograd.grad(found[found.isfinite()].sum(), seen)
    assert (gradient[0] != 0).all() and (gradient[1] == 0).all()


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 12, 14])
def test_other_models_are_refused(count):
    for call in (
        lambda: distort_points([[0, 0]], K, np.zeros(count)),
        lambda: undistort_points([[0, 0]], K, np.zeros(count)),
        lambda: project_distorted(K, [[0, 0, 1]], np.zeros(count)),
    ):
        with pytest.raises(ValueError, match="^distortion: expected 4, 5 or 8 coefficients: k1 k2"):
            call()


def test_choices():
    with pytest.raises(ValueError, match="^beyond: expected one of 'refuse', 'inf'"):
        undistort_points([[0, 0]], K, np.zeros(4), beyond="nan")
    with pytest.raises(ValueError, match="^beyond: "):
        distort_points([[0, 0]], K, np.zeros(4), beyond=None)
    with pytest.raises(ValueError, match="^behind: "):
        project_distorted(K, [[0, 0, 1]], np.zeros(4), behind="drop")
    for call in (distort_points, undistort_points):
        with pytest.raises(ValueError, match=r"^K: expected \[\[fx"):
            call([[0, 0]], np.zeros((3, 3)), np.zeros(4))
