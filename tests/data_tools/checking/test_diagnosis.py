"""Mistakes made in a dataset on disk are named; without one it is said to be fine."""

import shutil
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

import data_tools
from data_tools.checking import check_dataset
from tests.data_tools.checking import mistakes
from tests.data_tools.checking.made import MESHES, Made, corner

pytestmark = pytest.mark.slow

OPENGL = np.diag([1.0, -1, -1])
Y_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def checked(folder, split="test", **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of units and rotations: the reader's own
        return check_dataset(data_tools.open(f"bop:{folder}", split=split), **options)


def swapped(K):
    (fx, _, cx), (_, fy, cy), _ = K
    return np.array([[fy, 0, cx], [0, fx, cy], [0, 0, 1]])


def depth_scale(factor):
    def change(entry):
        entry["depth_scale"] *= factor

    return lambda folder: mistakes.change(folder, "scene_camera", change)


def masks_of_others(folder):
    for kind in ("mask", "mask_visib"):
        mistakes.renamed(folder, kind, mistakes.of_other_object)


def on_poses(function):
    return lambda folder: mistakes.poses(folder, function)


def on_cameras(function):
    return lambda folder: mistakes.cameras(folder, function)


ON_DISK = {
    "poses in metres": (on_poses(lambda R, t: (R, t / 1000)), "scaled translations",
                        "1000 times too small (metres taken for millimetres)"),
    "inverse poses": (on_poses(lambda R, t: (R.T, -R.T @ t)), "inverse poses", "from the camera"),
    "OpenGL": (on_poses(lambda R, t: (OPENGL @ R, OPENGL @ t)), "flipped axes", "OpenGL"),
    "half a pixel": (on_cameras(lambda K: K + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]),
                     "half a pixel", "half a pixel too large: they count the centre"),
    "cut images": (lambda f: mistakes.images(f, lambda image: mistakes.moved(image, 5, 3)),
                   "shifted images", "by (+5.0, +3."),
    "masks of others": (masks_of_others, "masks of another object", "other objects"),
    "scaled meshes": (lambda f: mistakes.models(f, 1.2), "scaled models",
                      "1.2 times too large: a scaled mesh"),
    "camera of larger images": (on_cameras(lambda K: np.diag([2, 2, 1]) @ K), "wrong image size",
                                "another size"),
    "unit of depth": (depth_scale(10), "depth unit", "10 times too large"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", ON_DISK)
def test_the_mistake_is_named(copy, mistake):
    make, key, words = ON_DISK[mistake]
    make(folder := copy())
    report = checked(folder)
    (finding,) = report.findings
    assert finding.key == key and words in finding.words and finding.objects is None
    assert finding.evidence
    lines = list(report.lines())
    assert f"OFF: {key}: {finding.words}" in lines


def test_what_is_right_is_fine(copy):
    report = checked(copy())
    assert report.fine and report.notes == [] and report.scores.min() > 0.97
    assert list(report.lines())[-1] == "fine: models, poses, camera and images fit together"


def test_before_and_after_are_said(copy):
    mistakes.poses(folder := copy(), lambda R, t: (R, t / 1000))
    (finding,) = checked(folder).findings
    first, second = finding.evidence
    assert first.startswith("masks overlap by 0.0") and "1.00 with translations times 1000" in first
    assert second.startswith("depth agrees in 0.0") and "in 1.00 with that" in second


def test_swapped_focal_lengths_are_seen_where_they_differ(copy):
    mistakes.cameras(folder := copy("tall"), swapped)
    (finding,) = checked(folder).findings
    assert finding.key == "swapped fx and fy"


def test_the_right_focal_lengths_are_fine(copy):
    assert checked(copy("tall")).fine


def test_one_scaled_mesh_is_said_with_its_number(copy):
    mistakes.models(folder := copy(), 1.3, only=8, infos=True)
    (finding,) = checked(folder).findings
    assert finding.key == "scaled models" and finding.objects == (8,)
    assert "its model is 1.3 times too large" in finding.words


def test_pictures_of_another_moment(copy):
    folder = copy()
    for kind in ("rgb", "depth"):
        mistakes.renamed(folder, kind, mistakes.of_next)
    report = checked(folder)
    assert report.keys == ["depth shifted by one image", "pictures shifted by one image"]


def test_pictures_that_were_cut_alone(copy):
    mistakes.images(folder := copy(), lambda image: mistakes.moved(image, 5, 3), ("rgb",))
    (finding,) = checked(folder).findings
    assert finding.key == "shifted pictures"


def pose(function):
    """Poses of objects through a function of R and t."""

    def change(item):
        R, t = function(item.R, item.t)
        return {"R": R, "t": t}

    return lambda made: made.items(change)


def camera(function):
    return lambda made: made.each(lambda view: replace(view, K=function(view.K)))


def mesh(factor, only=None):
    """Larger meshes."""

    def change(made):
        meshes = {
            i: mesh.copy().apply_scale(factor) if only in (None, i) else mesh
            for i, mesh in made.meshes.items()
        }
        return Made(made.views, meshes)

    return change


def without_depth(change):
    return lambda made: change(made).each(lambda view: replace(view, depth=None))


def boxes_alone(change):
    bare = {"mask": None, "full_mask": None}
    return lambda made: without_depth(change)(made).items(lambda _: bare)


def poses_of_next(made):
    views = made.views
    moved = [
        replace(
            view,
            objects=[
                replace(own, R=other.R, t=other.t)
                for own, other in zip(view.objects, later.objects, strict=True)
            ],
        )
        for view, later in zip(views, views[1:] + views[:1], strict=True)
    ]
    return Made(moved)


def both_swapped(K):
    (fx, _, cx), (_, fy, cy), _ = K
    return np.array([[fy, 0, cy], [0, fx, cx], [0, 0, 1]])


def mirrored(made):
    def flip(view):
        objects = [
            replace(o, mask=o.mask[:, ::-1], full_mask=o.mask[:, ::-1]) for o in view.objects
        ]
        return replace(view, rgb=view.rgb[:, ::-1], depth=view.depth[:, ::-1], objects=objects)

    return made.each(flip)


IN_MEMORY = {
    "poses in micrometres": (pose(lambda R, t: (R, t * 1000)), "scaled translations",
                             "1000 times too large (millimetres taken for metres)"),
    "models in metres": (mesh(1 / 1000), "scaled models",
                         "models are 1000 times too small (metres taken for millimetres)"),
    "models too large": (mesh(1000), "scaled models",
                         "models are 1000 times too large (millimetres taken for metres)"),
    "all in metres": (lambda m: pose(lambda R, t: (R, t / 1000))(mesh(1 / 1000)(m)),
                      "scaled models and translations", "1000 times too small"),
    "OpenGL in metres": (pose(lambda R, t: (OPENGL @ R, OPENGL @ t / 1000)),
                         "flipped axes and scaled translations", "OpenGL"),
    "rotations by column": (pose(lambda R, t: (R.T, t)), "transposed rotations", "column"),
    "upside down": (pose(lambda R, t: (np.diag([-1, -1, 1]) @ R, np.diag([-1, -1, 1]) @ t)),
                    "turned axes", "wrong sign"),
    "models with y up": (pose(lambda R, t: (R @ Y_UP, t)), "turned model", "x, -z, y"),
    "fx and fy": (camera(swapped), "swapped fx and fy", "swapped"),
    "x and y": (camera(both_swapped), "swapped x and y", "swapped"),
    "poses too far": (pose(lambda R, t: (R, t * 1.2)), "scaled translations",
                      "translations are 1.2 times too large"),
    "without depth": (without_depth(mesh(1.2)), "scale", "without depth one cannot tell"),
    "metres, without depth": (without_depth(pose(lambda R, t: (R, t / 1000))),
                              "scaled translations", "1000 times too small"),
    "boxes alone": (boxes_alone(pose(lambda R, t: (R.T, -R.T @ t))), "inverse poses", "inverse"),
    "another focal length": (camera(lambda K: K @ np.diag([1.2, 1.2, 1])), "wrong focal length",
                             "focal"),
    "cut and resized": (camera(lambda K: [[1.5, 0, 6], [0, 1.5, -4], [0, 0, 1]] @ K),
                        "cut and resized images", "cut and resized"),
    "poses of the next image": (poses_of_next, "shifted by one image", "previous"),
    "mirrored": (mirrored, "mirrored images", "left to right"),
    "inverted masks": (lambda m: m.items(lambda o: {"mask": ~o.mask, "full_mask": ~o.mask}),
                       "inverted masks", "white where the object is not"),
    "another origin": (pose(lambda R, t: (R, t + R @ [0.03, 0, -0.05])), "moved origin",
                       "origin"),
    "another camera": (pose(lambda R, t: (R, t + [0.06, 0, 0.01])), "moved camera", "beside"),
    "corners of boxes": (lambda m: m.items(lambda o: {"box": o.box + [0, 0, *o.box[:2]]}),
                         "boxes", "left, top, right, bottom"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", IN_MEMORY)
def test_more_mistakes_are_named(made, mistake):
    make, key, words = IN_MEMORY[mistake]
    report = check_dataset(make(made))
    findings = [f for f in report.findings if f.key != "diameters"]
    assert [f.key for f in findings] == [key]
    assert words in findings[0].words


def test_all_of_it_is_fine(made):
    for change in (lambda m: m, without_depth(lambda m: m), boxes_alone(lambda m: m)):
        assert check_dataset(change(made)).fine


def test_one_image_is_said(made):
    views = list(made.views)
    views[5] = poses_of_next(made).views[5]
    (finding,) = check_dataset(Made(views)).findings
    assert finding.key == "single images" and "scene 1, image 5: 0." in finding.words
    assert "image 4" not in finding.words


def test_an_object_that_nothing_explains(made):
    meshes = {**MESHES, 8: corner(0.02, 0.02, 0.3)}
    report = check_dataset(Made(made.views, meshes))
    (finding,) = [f for f in report.findings if f.key != "diameters"]
    assert finding.key == "an object that does not fit" and finding.objects == (8,)


def test_hand_drawn_masks_are_fine(made):
    """A pixel or two too large or too small."""
    rng = np.random.default_rng(0)

    def redrawn(item):
        change, size = (cv2.dilate, cv2.erode)[rng.integers(2)], int(rng.integers(1, 3))
        kernel = np.ones((size + 1, size + 1), np.uint8)
        mask = change(item.mask.astype(np.uint8), kernel).astype(bool)
        return {"mask": mask, "full_mask": mask}

    report = check_dataset(made.items(redrawn))
    assert report.fine and np.median(report.scores) < 0.9


def test_views_that_cannot_be_read(copy):
    next((folder := copy()).glob("test/*/mask_visib/000003_000000.png")).unlink()
    (finding,) = checked(folder).findings
    assert finding.key == "unreadable views" and "1 of 6 views" in finding.words
    assert "000003_000000: no such image" in finding.words


def test_few_images_do_not_tell_half_a_pixel(copy):
    report = checked(copy(), count=1)
    assert report.fine and any("colours: too few images" in note for note in report.notes)


def test_a_real_frame_is_fine(real_data):
    report = checked(real_data / "lmo")
    assert report.fine and report.kind == "depth" and 0.7 < report.scores[0] < 0.95
    assert any("have no model" in note for note in report.notes)


def test_a_real_frame_with_a_mistake(real_data, tmp_path):
    folder = shutil.copytree(real_data / "lmo", tmp_path / "lmo")
    mistakes.poses(folder, lambda R, t: (R, t / 1000))
    assert checked(folder).keys == ["scaled translations"]


def test_diameters_that_are_not_those_of_the_meshes(made):
    class Stated(Made):
        def models(self):
            models = super().models()
            models.info = lambda _: type("Info", (), {"diameter": 171.0})
            return models

    (finding,) = check_dataset(Stated(made.views)).findings
    assert finding.key == "diameters" and "is said to be 171 m, its mesh measures" in finding.words


def test_what_cannot_be_compared_is_refused(made):
    bare = boxes_alone(lambda m: m)(made).items(lambda _: {"box": None})
    bare = bare.each(lambda view: replace(view, rgb=np.zeros((120, 160, 3), np.uint8)))
    with pytest.raises(ValueError, match="^path: expected masks, depth or boxes"):
        check_dataset(bare)
    with pytest.raises(ValueError, match=r"^path: expected models of the objects, .*\[3, 8\]"):
        check_dataset(Made(made.views, {5: corner(0.1, 0.1, 0.1)}))
    with pytest.raises(ValueError, match="^no such image"):
        check_dataset(Made([ValueError("no such image")]))
    with pytest.raises(ValueError, match="^the dataset has no views"):
        check_dataset(Made([]))
    with pytest.raises(ValueError, match="^count: expected an integer of at least 1"):
        check_dataset(made, 0)
    empty = made.each(lambda view: replace(view, objects=()))
    with pytest.raises(ValueError, match="^path: expected images with poses of objects"):
        check_dataset(empty)


def test_models_that_cannot_be_read_are_left_out(made):
    class Lost(Made):
        def models(self):
            models = super().models()
            models.ids = (3, 8, 9)
            models.mesh = lambda i: MESHES[i] if i != 9 else open("no/mesh")
            return models

    report = check_dataset(Lost(made.views))
    assert report.fine and any("no model of objects 9" in note for note in report.notes)
