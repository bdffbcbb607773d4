"""Chapter 1's drawn picture is exact, and its figures say in words what they show."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from book.ch01_poses_and_cameras.drawing import measuring as chart
from book.ch01_poses_and_cameras.drawing import scenes as draw
from book.ch01_poses_and_cameras.drawing import stand_in
from posecore import cameras, metrics, poses, registration
from posecore.rotations import is_rotation

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def no_real_data(monkeypatch):
    monkeypatch.delenv("POSECORE_DATA", raising=False)


@pytest.fixture(scope="module", params=["mug", "can"])
def photo(request):
    return stand_in.photograph(request.param)


def first_hit(ray, corners):
    """Depth at which a ray (3,) with z = 1 from the origin meets triangles (F, 3, 3) first."""
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(ray, e2)
    det = (e1 * p).sum(1)
    safe = np.where(np.abs(det) > 1e-15, det, np.inf)  # seen from the edge, or without area
    u = -(a * p).sum(1) / safe
    q = np.cross(-a, e1)
    v, depth = (q @ ray) / safe, (e2 * q).sum(1) / safe
    hit = (np.abs(det) > 1e-15) & (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > 0)
    return depth[hit].min() if hit.any() else np.inf


def test_depth_and_mask_are_those_of_rays_through_the_mesh(photo, rng):
    corners = poses.apply(photo.R, photo.t, photo.vertices)[photo.faces]
    pixels = cameras.project(photo.K, corners.reshape(-1, 3))
    x_low, y_low = np.floor(pixels.min(0)).astype(int) - 3
    x_high, y_high = np.ceil(pixels.max(0)).astype(int) + 3
    hidden = 0
    for x, y in zip(
        rng.integers(x_low, x_high, 300), rng.integers(y_low, y_high, 300), strict=True
    ):
        depth = first_hit(np.linalg.solve(photo.K, [x, y, 1.0]), corners)
        if photo.mask[y, x]:
            assert photo.depth[y, x] == pytest.approx(depth, abs=1e-9)
        else:
            assert photo.depth[y, x] < depth + 1e-9
            hidden += np.isfinite(depth)
    assert (hidden > 0) == (photo.name == "can")  # the orange is in front of the can's foot


def test_measured_points_lie_on_the_model(photo):
    measured = cameras.depth_to_points(photo.depth, photo.K, photo.mask)[::7]
    dense, _ = stand_in.sample_surface(photo.vertices, photo.faces, 200_000)
    nearest = registration.icp(  # one step from the truth has nothing to mend
        measured, dense, *poses.invert(photo.R, photo.t), max_iterations=1
    )
    assert nearest.rmse < 5e-4
    assert metrics.rotation_error(nearest.R, photo.R.T) < 2e-3


def test_every_pixel_sees_something_and_no_pixel_two_things(photo):
    assert photo.depth.shape == photo.mask.shape == photo.rgb.shape[:2] == (360, 480)
    assert (photo.depth > 0).all()
    other = stand_in.photograph({"mug": "can", "can": "mug"}[photo.name])
    assert not (photo.mask & other.mask).any()
    assert np.array_equal(photo.rgb, other.rgb)


def test_the_record_describes_its_mesh(photo):
    assert is_rotation(photo.R, 1e-12)
    low, high = photo.vertices.min(0), photo.vertices.max(0)
    np.testing.assert_allclose(photo.size, high - low)
    np.testing.assert_allclose(photo.keypoints[8], (low + high) / 2)
    np.testing.assert_allclose(photo.centre, (low + high) / 2)
    assert all((keypoint == photo.vertices).all(1).any() for keypoint in photo.keypoints[:8])
    some = photo.vertices[:: len(photo.vertices) // 1500]
    assert pdist(some).max() <= photo.diameter <= pdist(some).max() + 0.005
    np.testing.assert_allclose(np.linalg.norm(photo.normals, axis=1), 1)


def test_points_have_the_paint_of_the_place_where_they_are():
    mug = stand_in.photograph("mug")
    assert mug.colours.shape == mug.points.shape
    assert (mug.colours >= 0).all() and (mug.colours <= 1).all()
    handle = mug.colours[mug.points[:, 0] > 0.045]
    assert len(handle) > 50 and (handle[:, 2] > handle[:, 0]).all()  # blue
    fish = (np.hypot(mug.points[:, 0], mug.points[:, 2] - 0.002) < 0.008) & (mug.points[:, 1] < 0)
    outside = mug.normals[:, 1] < 0
    assert (fish & outside).any()
    assert (mug.colours[fish & outside, 0] > mug.colours[fish & outside, 2]).all()  # orange


@pytest.mark.parametrize("mesh", [stand_in.mug(), stand_in.mug(32, 1), stand_in.can()])
def test_meshes_face_outwards(mesh):
    vertices, faces = mesh
    a, b, c = vertices[faces].transpose(1, 0, 2)
    volume = (a * np.cross(b, c)).sum() / 6
    assert 0 < volume < np.ptp(vertices, axis=0).prod()
    # Along each axis, the outermost faces look away from the middle.
    normals, middles = np.cross(b - a, c - a), (a + b + c) / 3
    for axis in range(3):
        assert normals[middles[:, axis].argmax(), axis] >= 0
        assert normals[middles[:, axis].argmin(), axis] <= 0


def test_the_can_is_symmetric_and_the_mug_is_not(photo):
    turn = np.diag([-1.0, -1, 1])
    error = metrics.add_s(turn, np.zeros(3), np.eye(3), np.zeros(3), photo.vertices)
    assert (error < 1e-9) == (photo.name == "can")


def test_rasterise_agrees_with_rays(rng):
    K = np.array([[40.0, 0, 15.5], [0, 40, 11.5], [0, 0, 1]])
    vertices = np.concatenate([rng.uniform(-0.4, 0.4, (60, 2)), rng.uniform(1, 2, (60, 1))], 1)
    faces = np.arange(60).reshape(20, 3)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    away = (np.cross(b - a, c - a) * a).sum(1) > 0  # only outer sides are drawn
    faces[away] = faces[away][:, ::-1]
    depth, face, weights = stand_in.rasterise(K, vertices, faces, (32, 24))
    assert (face >= 0).mean() > 0.1
    for y, x in np.ndindex(depth.shape):
        expected = first_hit(np.linalg.solve(K, [x, y, 1.0]), vertices[faces])
        assert depth[y, x] == pytest.approx(expected if np.isfinite(expected) else 0, abs=1e-9)
    points = np.einsum("hwk,hwkc->hwc", weights, vertices[faces[face]])
    seen = cameras.back_project(depth, K)
    np.testing.assert_allclose(points[face >= 0], seen[face >= 0], atol=1e-9)


def test_drawing_it_again_gives_the_same_bytes(monkeypatch):
    fine = stand_in._drawn()
    monkeypatch.setattr(stand_in, "FINER", 1)  # much faster
    once, again = stand_in._drawn.__wrapped__(), stand_in._drawn.__wrapped__()
    assert once["rgb"].tobytes() == again["rgb"].tobytes()
    assert once["depth"].tobytes() == again["depth"].tobytes()
    # Depth and owner are those of the pixel's centre, however many samples a pixel has.
    np.testing.assert_allclose(once["depth"], fine["depth"], rtol=1e-9)
    assert np.array_equal(once["owner"], fine["owner"])
    assert np.abs(once["rgb"].astype(int) - fine["rgb"]).mean() < 3


def test_the_picture_is_lit_and_colourful():
    rgb = stand_in.photograph().rgb.astype(int)
    assert 60 < rgb.mean() < 190 and rgb.std() > 25
    assert (rgb.min(2) < 30).any() and (rgb.max(2) > 200).any()
    assert (np.ptp(rgb, axis=2) > 100).mean() > 0.02


def test_unknown_things_are_refused():
    with pytest.raises(ValueError, match="name: expected one of 'mug', 'can'"):
        stand_in.photograph("spoon")


def test_without_real_data_everything_is_drawn():
    assert draw.photograph().source == draw.scan().source == "drawn stand-in"
    assert draw.real_results() is None


def errors_of(title):
    degrees, millimetres = title.split(": ")[1].split(", ")
    return float(degrees.rstrip("°")), float(millimetres.removesuffix(" mm"))


def test_the_still_form_of_the_slider_says_what_pnp_finds():
    photo = draw.photograph()
    figure = draw.dragged_keypoint(photo, right=40, down=-10, keypoint=3)
    pixels = cameras.project(photo.K, poses.apply(photo.R, photo.t, photo.keypoints[:8]))
    pixels[3] += 40, -10
    for axes, method in zip(figure.axes, ("iterative", "ransac"), strict=True):
        found = registration.pnp(photo.keypoints[:8], pixels, photo.K, method)
        degrees, millimetres = errors_of(axes.get_title())
        off = np.degrees(metrics.rotation_error(found.R, photo.R))
        assert degrees == pytest.approx(off, abs=0.05)
        assert millimetres == pytest.approx(1000 * np.linalg.norm(found.t - photo.t), abs=0.05)
        assert axes.get_title() in figure.alt
    assert "Keypoint 3 is dragged 40 px to the right and -10 px down" in figure.alt
    assert figure.get_suptitle() == "keypoint 3: 40 px to the right, -10 px down"
    assert figure.png() == draw.dragged_keypoint(photo, right=40, down=-10, keypoint=3).png()


def test_a_keypoint_that_stays_moves_nothing():
    figure = draw.dragged_keypoint(draw.photograph(), right=0, down=0)
    assert [errors_of(axes.get_title()) for axes in figure.axes] == [(0, 0), (0, 0)]


@pytest.mark.parametrize("corner", [(-80, -80), (80, 80)])
@pytest.mark.parametrize("keypoint", range(8))
def test_the_slider_works_in_its_whole_range(corner, keypoint):
    figure = draw.dragged_keypoint(draw.photograph(), *corner, keypoint=keypoint)
    assert errors_of(figure.axes[1].get_title())[0] < 0.1  # RANSAC is not impressed


def test_outlines_are_where_the_object_is():
    mug = chart.mug()
    figure = chart.on_the_photograph(mug, {"itself": (mug.R, mug.t)}, alt="a mug")
    outline = max((line.get_xydata() for line in figure.axes[0].lines), key=len)
    rows, columns = np.nonzero(mug.mask)
    inside = np.stack([columns, rows], 1)
    np.testing.assert_allclose(outline.min(0), inside.min(0), atol=1)
    np.testing.assert_allclose(outline.max(0), inside.max(0), atol=1)


SIMPLE_FIGURES = {
    "question": lambda: draw.question(draw.photograph()),
    "pinhole": lambda: draw.pinhole(draw.photograph()),
    "pixel_grid": draw.pixel_grid,
    "depth": lambda: draw.depth_picture(draw.scan()),
    "above": lambda: chart.seen_from_above(chart.mug(), chart.mug().R, chart.mug().t * 1.05),
    "scoreboard": lambda: chart.scoreboard({"a": {"x": True}, "b": {"x": False}}),
    "precision": lambda: chart.precision_recall(np.array([0.5, 1]), np.array([1, 0.5]), 0.75),
}


@pytest.mark.parametrize("name", SIMPLE_FIGURES)
def test_figures_have_words_and_repeat_byte_for_byte(name):
    first, second = SIMPLE_FIGURES[name](), SIMPLE_FIGURES[name]()
    assert len(first.alt) > 60 and first.alt == second.alt
    assert first.png() == second.png()


def test_the_scoreboard_says_in_words_what_it_shows():
    figure = chart.scoreboard(
        {"near": {"ADD": True, "2D": True}, "far": {"ADD": False, "2D": False}}
    )
    assert "near: correct by ADD, 2D; far: correct by none" in figure.alt
    assert [text.get_text() for text in figure.axes[0].texts] == ["✓", "✓", "✗", "✗"]
