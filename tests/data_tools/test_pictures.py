import json
import warnings

import cv2
import numpy as np
import pytest
from PIL import Image

import data_tools
from data_tools.pictures import CameraWarning, PictureFolder, read_camera

K = [[60.0, 0, 15.5], [0, 61, 11.5], [0, 0, 1]]
BOP = {"fx": 60, "fy": 61, "cx": 15.5, "cy": 11.5, "depth_scale": 0.1}


@pytest.fixture
def folder(tmp_path):
    """A folder `photos` of three pictures, its camera beside it."""
    photos = tmp_path / "photos"
    photos.mkdir()
    for number in (2, 10, 9):
        rgb = np.full((24, 32, 3), number, np.uint8)
        rgb[..., 0] = 200
        Image.fromarray(rgb).save(photos / f"IMG_{number}.png")
    (photos / "notes.txt").write_text("mine")
    write(tmp_path / "camera.json", {**BOP, "width": 32, "height": 24})
    return photos


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def test_pictures_as_views(folder):
    dataset = data_tools.open(f"pictures:{folder}")
    assert len(dataset) == 3 and dataset.files == ["IMG_2.png", "IMG_9.png", "IMG_10.png"]
    assert dataset.image_ids == [2, 9, 10] and dataset.object_ids == ()
    for view, number in zip(dataset, (2, 9, 10), strict=True):
        assert (view.scene_id, view.image_id, view.objects) == (0, number, ())
        assert view.rgb[0, 0].tolist() == [200, number, number] and view.ir is None
        np.testing.assert_array_equal(view.K, K)
    assert "3 pictures" in repr(dataset)


@pytest.mark.parametrize(
    ("names", "ids"),
    [
        (["a1.png", "a20.png", "a3.png"], [1, 3, 20]),
        (["20240103_1.png", "20240103_2.png"], [1, 2]),
        (["left_1.png", "right_1.png"], [0, 1]),  # a number twice
        (["1.png", "front.png"], [0, 1]),
        (["b.png", "a.png"], [0, 1]),
    ],
)
def test_numbers_of_pictures(folder, names, ids):
    for file in folder.iterdir():
        file.unlink()
    for name in names:
        cv2.imwrite(str(folder / name), np.zeros((24, 32, 3), np.uint8))
    dataset = PictureFolder(folder)
    assert dataset.image_ids == ids and sorted(dataset.files) == sorted(names)


def test_grey_pictures_are_infrared_too(folder):
    cv2.imwrite(str(folder / "IMG_3.png"), np.full((24, 32), 77, np.uint8))
    cv2.imwrite(str(folder / "IMG_4.png"), np.full((24, 32), 7777, np.uint16))
    dataset = PictureFolder(folder)
    shallow, deep = dataset[1], dataset[2]
    assert (shallow.rgb == 77).all() and (shallow.ir == 77).all()
    assert deep.rgb is None and (deep.ir == 7777).all() and deep.ir.dtype == np.uint16


@pytest.mark.parametrize(
    "content",
    [
        BOP,
        {"K": K},
        {"cam_K": np.ravel(K).tolist()},
        {"camera_matrix": K, "note": "mine", "dist": [0, 0, 0, 0, 0]},
        K,
        np.ravel(K).tolist(),
    ],
)
def test_cameras(tmp_path, content):
    found, size = read_camera(write(tmp_path / "c.json", content))
    np.testing.assert_array_equal(found, K)
    assert size is None


def test_where_the_camera_is(folder, tmp_path):
    assert PictureFolder(folder).camera == tmp_path / "camera.json"
    write(folder / "camera.json", {**BOP, "fx": 90})
    assert PictureFolder(folder).K[0, 0] == 90, "that in the folder comes first"
    other = write(tmp_path / "other.json", {**BOP, "fx": 70})
    assert PictureFolder(folder, camera=other).K[0, 0] == 70


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"fx": 60, "fy": 61, "cx": 15}, "expected fx, fy, cx and cy, or K with nine numbers, got"),
        ({"0": {"cam_K": K}}, r"expected fx, fy, cx and cy, .*\['0'\]"),
        ("K", "expected fx, fy, cx and cy"),
        ({"K": [1, 2, 3]}, "K: expected 9 finite numbers"),
        ({"K": [[1, 2], [3, 4], [5, 6]]}, "K: expected 9 finite numbers"),
        ({**BOP, "fx": "60"}, "fx: expected a finite number"),
        ({**BOP, "fx": -60}, "K: expected fx s cx"),
        ({"K": np.transpose(K).tolist()}, "K: expected fx s cx"),
        ({**BOP, "width": 0, "height": 24}, "width, height: expected whole numbers above 0"),
    ],
)
def test_damaged_cameras(tmp_path, content, message):
    path = write(tmp_path / "c.json", content)
    with pytest.raises(ValueError, match=f"^{path}: {message}"):
        read_camera(path)


def test_what_is_refused(folder, tmp_path):
    with pytest.raises(ValueError, match="^path: expected a folder of pictures, got"):
        PictureFolder(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"^path: expected a folder with pictures \(.png"):
        PictureFolder(tmp_path)
    with pytest.raises(ValueError, match="^split: expected None, as a folder of pictures has no"):
        PictureFolder(folder, "train")
    with pytest.raises(ValueError, match="^camera: expected a JSON file with fx"):
        PictureFolder(folder, camera=tmp_path / "no.json")
    (tmp_path / "camera.json").unlink()
    with pytest.raises(ValueError, match=r"^camera: expected a file, as there is no camera.json"):
        PictureFolder(folder)
    with pytest.raises(ValueError, match="no models: it is a folder of pictures"):
        PictureFolder(folder, camera=write(tmp_path / "c.json", K)).models()


def test_pictures_of_another_size(folder, tmp_path):
    cv2.imwrite(str(folder / "IMG_1.png"), np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(ValueError, match=r"IMG_1.png: expected 32 x 24 pixels as .*got 64 x 48"):
        PictureFolder(folder)[0]
    (folder / "IMG_1.png").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"IMG_1.png: neither PNG nor JPEG"):
        PictureFolder(folder)[0]


def test_a_camera_that_may_be_another(folder, tmp_path):
    camera = write(tmp_path / "c.json", {**BOP, "cx": 320, "cy": 240})
    with pytest.warns(CameraWarning, match="cx, cy = 320, 240 lies outside pictures of 32 x 24"):
        dataset = PictureFolder(folder, camera=camera)
        list(dataset)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dataset[0]  # it is said once


@pytest.mark.parametrize("lens", [{"dist": [0.1, 0]}, {"k1": -0.2}, {"distortion": [0.1]}])
def test_lenses_are_not_left_out_without_a_word(tmp_path, lens):
    path = write(tmp_path / "c.json", {**BOP, **lens, "distance_unit": "mm"})
    with pytest.warns(CameraWarning, match="lens distortion .* is not used: pictures must be"):
        read_camera(path)


def test_photographs_that_are_marked_as_turned(folder):
    exif = Image.Exif()
    exif[274] = 6
    for number in (4, 5):
        picture = Image.fromarray(np.full((24, 32, 3), 90, np.uint8))
        picture.save(folder / f"IMG_{number}.jpg", exif=exif)
    dataset = PictureFolder(folder)
    with pytest.warns(CameraWarning, match=r"EXIF orientation 6.*32 x 24") as told:
        views = list(dataset)
    assert len(told) == 1 and {view.shape for view in views} == {(24, 32)}
