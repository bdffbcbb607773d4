"""The figures of chapter 2's tour say in words what they show, and show what the numbers say."""

import numpy as np
import pytest

import data_tools
from book.ch02_small_worlds.drawing import categories as gallery
from book.ch02_small_worlds.drawing import light
from book.ch02_small_worlds.drawing import statistics as counts
from book.ch02_small_worlds.drawing import worlds as tour
from data_tools import renderer, shapes
from data_tools.worlds import headset
from posecore import cameras, metrics, poses
from posecore.rotations import euler_to_matrix

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def instant():
    dataset = data_tools.open("headset", split="test", scale="tiny", progress=False, whole=False)
    return [dataset[i] for i in range(3)]


@pytest.fixture(scope="module")
def table():
    return data_tools.open("tabletop", split="easy", scale="tiny", progress=False, whole=False)[3]


@pytest.fixture(scope="module")
def mug():
    dataset = data_tools.open("categories", split="synthetic", scale="tiny", progress=False,
                              whole=False)  # fmt: skip
    return next(view for view in map(dataset.__getitem__, range(6, 12))
                if view.objects[0].category == "mug")  # fmt: skip


def test_the_wall_leans_as_asked_and_is_matt(rng):
    lean = np.radians(25)
    wall = light.wall(0.7, lean)
    assert {m.specular for m in wall.mesh.materials} == {0.0}
    assert {m.infrared for m in wall.mesh.materials} == {0.7}
    K = np.array([[100.0, 0, 19.5], [0, 100, 14.5], [0, 0, 1]])
    labels = renderer.render_labels([wall], [(np.eye(3), np.array([0, 0, 1.0]))], K, (40, 30))
    assert (labels.instance == 0).all()
    points = cameras.depth_to_points(labels.depth, K)
    normals = labels.normals.reshape(-1, 3)
    np.testing.assert_allclose(normals, np.broadcast_to(normals[0], normals.shape), atol=1e-6)
    assert np.arccos(-normals[0, 2]) == pytest.approx(lean, abs=1e-6)
    np.testing.assert_allclose((points - [0, 0, 1]) @ normals[0], 0, atol=1e-6)


def test_things_of_the_depth_scene_stand_on_its_floor_and_are_apart():
    things, seen, K = light.depth_scene()
    floor = seen[-2]
    corners = []
    for thing, pose in zip(things[:-2], seen[:-2], strict=True):
        points = poses.apply(*pose, thing.mesh.vertices)
        in_world = poses.apply(*poses.invert(*floor), points)
        assert in_world[:, 2].min() == pytest.approx(0, abs=1e-6)
        corners.append(in_world)
        pixels = cameras.project(K, points)
        assert ((pixels > -1) & (pixels < [240, 180])).all(), thing.mesh.name
    for number, one in enumerate(corners):
        for other in corners[:number]:
            gaps = np.linalg.norm(one[::9, None] - other[None, ::9], axis=-1)
            assert gaps.min() > 0.005


def test_a_print_may_be_seen_in_colour_only():
    mug = shapes.make_category("mug", 58)  # the page's: stripes of one infrared albedo
    colour, infrared = light.in_both_lights([mug], np.diag([1.0, -1, -1]))
    assert colour.shape == (200, 170, 3) and infrared.shape == (200, 170)
    for image in (colour, infrared):
        assert image.min() >= 0 and image.max() <= 1
    row = np.s_[108, 92:99]  # from a bright stripe to a dark one, off the highlight
    steps = [np.abs(np.diff(values)).max() for values in (colour[row][:, 1], infrared[row])]
    assert steps[0] > 0.2 and steps[1] < 0.06, steps


def test_axes_are_drawn_where_the_pose_is(instant):
    figure = tour.three_cameras(instant, headset.CAMERAS)
    assert [axes.get_title() for axes in figure.axes] == list(headset.CAMERAS)
    for axes, view in zip(figure.axes, instant, strict=True):
        glasses = view.objects[0]
        origin = cameras.project(view.K, glasses.t[None])[0]
        for line in axes.lines:
            np.testing.assert_allclose(line.get_xydata()[0], origin)


def test_the_car_holds_the_head_before_three_cameras(instant):
    T = [T for _, T in headset.cameras(160, 94)]
    viewer = tour.in_the_car(instant[1], T, headset.CAMERAS)
    labels = [part["label"] for part in viewer.payload()["parts"]]
    assert labels[:2] == ["head", "glasses"]
    assert {f"{name} camera" for name in headset.CAMERAS} <= set(labels)
    assert "wearer's left" in viewer.alt


def test_boxes_enclose_the_objects(table):
    size = {o.object_id: o.size for o in table.objects}
    figure = tour.tables({"easy": table}, size)
    lines = figure.axes[0].lines
    assert len(lines) == 12 * len(table.objects)
    for number, item in enumerate(table.objects):
        box = np.concatenate([line.get_xydata() for line in lines[12 * number : 12 * number + 12]])
        vertices = shapes.make_object(item.object_id).vertices
        pixels = cameras.project(table.K, poses.apply(item.R, item.t, vertices))
        assert (pixels.min(0) >= box.min(0) - 1e-6).all()
        assert (pixels.max(0) <= box.max(0) + 1e-6).all()
    assert not tour.tables({"easy": table}, {}).axes[0].lines


def test_the_silhouette_goes_on_beyond_the_border(table):
    height, width = table.shape
    full = np.zeros((3 * height, 3 * width), bool)
    full[height : 2 * height, width : 2 * width] = table.objects[0].mask
    full[height : height + 9, width - 12 : width + 20] = True  # beyond the left border
    figure = tour.outside_the_image(table, 0, full, 0.25)
    assert f"of {full.sum()} pixels: 0.25" in figure.axes[0].get_title()
    outlines = [line for line in figure.axes[0].lines if line.get_gid() == "outline"]
    assert np.nanmin(outlines[0].get_xydata()[:, 0]) == 8 - 0.5  # the part outside is drawn


def test_bins_of_angles_are_those_of_bmae(rng):
    angles = rng.normal(0, [0.3, 0.2, 0.1], (300, 3))
    figure = counts.angles_of_heads(angles, np.radians(5))
    for axes, values in zip(figure.axes, angles.T, strict=True):
        heights = np.array([bar.get_height() for bar in axes.patches])
        expected = np.bincount(np.floor(np.abs(values) / np.radians(5)).astype(int))
        np.testing.assert_array_equal(heights[: len(expected)], expected)
        rare = [bar for bar in axes.patches if bar.get_hatch()]
        assert len(rare) == (heights < 10).sum()
        weighted = metrics.balanced_mean_angular_error(values * 0 + 1, values)
        assert weighted == pytest.approx(1)


def test_bars_and_words_agree():
    fractions = {"easy": np.full(20, 0.95), "occluded": np.linspace(0, 1, 21)[:20]}
    figure = counts.visible_fractions(fractions)
    assert "easy 0 %, occluded 50 %" in figure.alt
    shares = [bar.get_height() for bar in figure.axes[0].patches]
    assert sum(shares[:10]) == pytest.approx(100) and sum(shares[10:]) == pytest.approx(100)
    missing = counts.missing_depth(["a", "b"], {"easy": np.array([0.1, 0.3]),
                                               "occluded": np.array([0.2, 0.5])})  # fmt: skip
    assert "the b loses most" in missing.alt
    assert [bar.get_height() for bar in missing.axes[0].patches] == pytest.approx([10, 30, 20, 50])


def test_viewpoints_are_drawn_by_azimuth_and_sine(rng):
    d = rng.normal(size=(50, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    figure = counts.viewpoints({"easy": d, "occluded": d[:10]})
    x, y = figure.axes[0].collections[0].get_offsets().T
    np.testing.assert_allclose(np.tan(np.radians(x)), d[:, 1] / d[:, 0], rtol=1e-6)
    np.testing.assert_allclose(y, d[:, 2])
    assert f"easy: {100 * np.mean(d[:, 2] < 0):.0f} % from below" in figure.alt


def test_seen_pixels_lie_in_the_box(mug):
    item = mug.objects[0]
    points = item.coordinates[item.mask]
    nocs = points / np.linalg.norm(item.size) + 0.5
    figure = gallery.coordinates_in_space(mug, points, nocs)
    for axes in figure.axes:
        drawn, box = np.asarray(axes.collections[0].get_offsets()), axes.patches[0].get_bbox()
        assert (drawn >= np.array(box.min) - 0.01).all() and (
            drawn <= np.array(box.max) + 0.01
        ).all()


def _depths():
    exact = np.linspace(0.5, 1, 300).reshape(15, 20)
    reasons = np.full(exact.shape, -1)
    reasons[:3] = 0
    return exact, np.where(reasons < 0, exact, 0), reasons


TURNS = {"straight": np.eye(3), "yaw": euler_to_matrix(np.radians([30.0, 0, 0]), "YXZ")}
FIGURES = {
    "two distances": lambda: light.two_distances({0.5: np.ones((8, 9)), 1.0: np.ones((8, 9)) / 4}),
    "brightness": lambda: light.brightness(np.array([0.5, 1]), np.array([1, 0.25]), -2),
    "things": lambda: light.same_things({"a": (np.full((8, 9, 3), 0.5), np.full((8, 9), 0.2))}),
    "shadows": lambda: light.why_shadows(570, 0.075),
    "noise": lambda: light.noise_of_depth(np.array([1.0, 2]), np.array([1, 4]) / 1e3,
                                          np.array([1, 4]) / 1e3, 1e-3),
    "holes": lambda: light.depth_and_holes(*_depths(), ["shadow", "edge"]),
    "exposures": lambda: light.exposures({1.0: np.full((180, 240, 3), 90, np.uint8)}),
    "glasses": tour.four_glasses,
    "turns": lambda: tour.head_turns(TURNS),
    "sizes": lambda: counts.sizes({"mug": np.full((3, 3), 0.1), "can": np.full((2, 3), 0.2)}),
}  # fmt: skip


@pytest.mark.parametrize("name", FIGURES)
def test_figures_have_words_and_repeat_byte_for_byte(name):
    first, second = FIGURES[name](), FIGURES[name]()
    assert len(first.alt) > 60 and first.alt == second.alt
    assert first.png() == second.png()


def test_figures_of_views_have_words(instant, table, mug):
    nocs = np.zeros((*mug.shape, 3))
    pictures = [
        tour.faces(instant),
        gallery.strip({"synthetic": [mug] * 3, "shifted": [mug] * 3}),
        gallery.coordinates([(mug, nocs)]),
        gallery.mugs([mug], [0.25]),
    ]
    assert all(len(figure.alt) > 60 for figure in pictures)
    assert "handle: 25 % of the pixels" in pictures[-1].alt
