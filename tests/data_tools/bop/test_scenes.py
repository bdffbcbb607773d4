import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_tools.bop.rotations import RotationWarning
from data_tools.bop.scenes import PlaceholderWarning, read_annotations, read_by_id, read_cameras

K = [500.5, 0, 320, 0, 501, 240, 0, 0, 1]
EYE = np.eye(3).ravel().tolist()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("scene")


def write(folder, content, name="scene_camera.json"):
    (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder / name


@given(ids=st.lists(st.integers(0, 10**6), unique=True))
def test_ids_are_sorted_as_numbers(folder, ids):
    content = {str(i): f"entry {i}" for i in ids}
    read = read_by_id(write(folder, content))
    assert list(read.items()) == [(i, f"entry {i}") for i in sorted(ids)]


@pytest.mark.parametrize("key", ["a", "", "-1", "1.0", "01", " 1", "٣"])
def test_keys_that_are_no_ids_are_refused(folder, key):
    with pytest.raises(ValueError, match=r"scene_camera\.json: expected ids as keys"):
        read_by_id(write(folder, {"2": 1, key: 2}))


@given(seed=st.integers(0, 2**32))
def test_cameras(folder, seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=seed % 2**32).as_matrix()
    t = rng.normal(size=3) * 1000
    pose = {"cam_R_w2c": R.ravel().tolist(), "cam_t_w2c": t.tolist()}
    cameras = read_cameras(
        write(folder, {"7": {"cam_K": K}, "2": {"cam_K": K, "depth_scale": 0.25, **pose}}),
        "project",
    )
    assert list(cameras) == [2, 7]
    np.testing.assert_array_equal(cameras[2].K, np.reshape(K, (3, 3)))
    assert cameras[2].depth_scale == 0.25
    assert cameras[7].depth_scale is None
    assert cameras[7].T_world_cam is None
    # Forth by hand and back by the matrix.
    X_world = rng.normal(size=3)
    X_cam = R @ X_world + t / 1000
    back = cameras[2].T_world_cam @ [*X_cam, 1]
    np.testing.assert_allclose(back, [*X_world, 1], atol=1e-13)


def test_camera_rotations_follow_the_choice(folder):
    pose = {"cam_R_w2c": (1.01 * np.eye(3)).ravel().tolist(), "cam_t_w2c": [1000, 0, 0]}
    path = write(folder, {"0": {"cam_K": K, **pose}})
    with pytest.warns(RotationWarning, match=r"scene_camera\.json: 1 of 1"):
        projected = read_cameras(path, "project")[0].T_world_cam
    np.testing.assert_allclose(
        projected[:3], [[1, 0, 0, -1], [0, 1, 0, 0], [0, 0, 1, 0]], atol=1e-15
    )
    as_read = read_cameras(path, "as_read")[0].T_world_cam
    np.testing.assert_allclose(as_read[0], [1 / 1.01, 0, 0, -1 / 1.01], atol=1e-15)
    np.testing.assert_array_equal(as_read[3], [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "expected a JSON object, got a list"),
        ({"3": {}}, "image 3: cam_K is missing"),
        ({"3": {"cam_K": K[:8]}}, "image 3: cam_K: expected 9 finite numbers"),
        ({"3": {"cam_K": K, "depth_scale": 0}}, "image 3: depth_scale: expected above 0"),
        ({"3": {"cam_K": K, "depth_scale": "1"}}, "image 3: depth_scale: expected a finite number"),
        ({"3": {"cam_K": K, "cam_R_w2c": EYE}}, "image 3: cam_t_w2c is missing"),
        ({"3": {"cam_K": K, "cam_t_w2c": [0, 0, 0]}}, "image 3: cam_R_w2c is missing"),
        (
            {"2": {"cam_K": K}, "3": {"cam_K": K, "cam_R_w2c": [0] * 9, "cam_t_w2c": [0, 0, 0]}},
            "image 3: expected a rotation",
        ),
        ({"3": None}, "image 3: expected a JSON object, got None"),
    ],
)
def test_damaged_cameras_are_refused(folder, content, message):
    with pytest.raises(ValueError, match=rf"scene_camera\.json: {message}"):
        read_cameras(write(folder, content), "project")


def pose(i, R=EYE, t=(1000, 2000, 3000)):
    return {"obj_id": i, "cam_R_m2c": list(R), "cam_t_m2c": list(t)}


@given(seed=st.integers(0, 2**32), counts=st.lists(st.integers(0, 4), max_size=4))
def test_annotations(folder, seed, counts):
    rng = np.random.default_rng(seed)
    gt, infos = {}, {}
    for image, count in enumerate(counts):
        R = Rotation.random(count, random_state=image).as_matrix() if count else []
        gt[str(image)] = [pose(int(rng.integers(99)), M.ravel(), rng.normal(size=3)) for M in R]
        infos[str(image)] = [
            {"bbox_visib": rng.integers(0, 99, 4).tolist(), "visib_fract": rng.random()} for _ in R
        ]
    path = write(folder, gt, "scene_gt.json")
    found = read_annotations(path, write(folder, infos, "scene_gt_info.json"), "project")
    assert [len(rows) for rows in found.rows.values()] == counts
    for image, rows in found.rows.items():
        for row, entry, seen in zip(rows, gt[str(image)], infos[str(image)], strict=True):
            assert found.object_id[row] == entry["obj_id"]
            np.testing.assert_allclose(found.R[row].ravel(), entry["cam_R_m2c"], atol=1e-14)
            np.testing.assert_array_equal(found.t[row], np.array(entry["cam_t_m2c"]) / 1000)
            np.testing.assert_array_equal(found.box[row], seen["bbox_visib"])
            assert found.visible_fraction[row] == seen["visib_fract"]
    alone = read_annotations(path, None, "as_read")
    assert alone.box is None
    assert alone.visible_fraction is None
    assert len(alone.R) == sum(counts)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "expected a JSON object, got a list"),
        ({"3": pose(1)}, "image 3: expected a list, got a dict"),
        ({"3": [pose(1), {"obj_id": 1}]}, "image 3, pose 1: cam_R_m2c is missing"),
        ({"3": [5]}, "image 3, pose 0: expected a JSON object, got 5"),
        ({"3": [pose(-1)]}, "image 3, pose 0: obj_id: expected an integer"),
        ({"3": [pose("can")]}, "image 3, pose 0: obj_id: expected an integer"),
        ({"3": [pose(1, EYE[:8])]}, "image 3, pose 0: cam_R_m2c: expected 9"),
        ({"3": [pose(1, t=[1, 2])]}, "image 3, pose 0: cam_t_m2c: expected 3"),
        ({"3": [pose(1, t=[1, 2, None])]}, "image 3, pose 0: cam_t_m2c: expected 3"),
        (
            {"2": [pose(1)], "3": [pose(1), pose(1, [1] * 9)]},
            "image 3, pose 1: expected a rotation",
        ),
        ({"3": [pose(1, np.diag([1.0, 1, -1]).ravel())]}, "image 3, pose 0: expected a rotation"),
    ],
)
def test_damaged_poses_are_refused(folder, content, message):
    with pytest.raises(ValueError, match=rf"scene_gt\.json: {message}"):
        read_annotations(write(folder, content, "scene_gt.json"), None, "as_read")


SEEN = {"bbox_visib": [0, 0, 1, 1], "visib_fract": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "image 3 is not in both"),
        ({"3": [SEEN], "4": []}, "image 4 is not in both"),
        ({"3": SEEN}, "image 3: expected a list, got a dict"),
        ({"3": []}, "image 3: expected 1 entries as in scene_gt, got 0"),
        ({"3": [SEEN, SEEN]}, "image 3: expected 1 entries as in scene_gt, got 2"),
        ({"3": [{**SEEN, "visib_fract": 1.5}]}, "image 3, pose 0: visib_fract: expected 0 to 1"),
        ({"3": [{**SEEN, "bbox_visib": [0, 0, -1, 5]}]}, "pose 0: bbox_visib: expected x, y, w, h"),
        ({"3": [{**SEEN, "bbox_visib": [0, 0, 1]}]}, "pose 0: bbox_visib: expected 4"),
        ({"3": [{"visib_fract": 1}]}, "image 3, pose 0: bbox_visib is missing"),
        ({"3": [{"bbox_visib": [0, 0, 1, 1]}]}, "image 3, pose 0: visib_fract is missing"),
    ],
)
def test_infos_that_do_not_fit_are_refused(folder, content, message):
    path = write(folder, {"3": [pose(1)]}, "scene_gt.json")
    info = write(folder, content, "scene_gt_info.json")
    with pytest.raises(ValueError, match=rf"scene_gt_info\.json: .*{message}"):
        read_annotations(path, info, "project")


def test_placeholders_are_known_to_be_none(tmp_path):
    """Whoever lacks a pose writes -1 everywhere; the poses beside it are read."""
    pose = {"obj_id": 5, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 700]}
    lost = {"obj_id": 6, "cam_R_m2c": [-1] * 9, "cam_t_m2c": [-1.0] * 3}
    (tmp_path / "gt.json").write_text(json.dumps({"3": [lost, pose], "4": [pose]}))
    seen = {"visib_fract": 0.5, "bbox_visib": [0, 0, 1, 1]}
    infos = {"3": [{"visib_fract": -1, "bbox_visib": [-1] * 4}, seen], "4": [seen]}
    (tmp_path / "info.json").write_text(json.dumps(infos))
    with pytest.warns(PlaceholderWarning, match=r"gt.json: 1 of 3 poses are placeholders"):
        found = read_annotations(tmp_path / "gt.json", tmp_path / "info.json", "project")
    assert found.known.tolist() == [False, True, True]
    assert found.rows == {3: range(2), 4: range(2, 3)}  # masks are counted as in the file
    np.testing.assert_array_equal(found.R[1:], [np.eye(3)] * 2)
    assert np.isnan(found.box[0]).all() and found.visible_fraction.tolist() == [0, 0.5, 0.5]
    camera = {
        "cam_K": [500, 0, 2, 0, 500, 2, 0, 0, 1],
        "cam_R_w2c": [-1] * 9,
        "cam_t_w2c": [-1] * 3,
    }
    (tmp_path / "camera.json").write_text(json.dumps({"3": camera}))
    assert read_cameras(tmp_path / "camera.json", "project")[3].T_world_cam is None


@pytest.mark.parametrize("key", ["9" * 19, "9" * 5000, "٣", "²"])
def test_ids_that_fit_nowhere(tmp_path, key):
    (tmp_path / "gt.json").write_text(json.dumps({key: []}))
    with pytest.raises(ValueError, match="gt.json: expected ids as keys, got") as caught:
        read_annotations(tmp_path / "gt.json", None, "project")
    assert len(str(caught.value)) < 300
