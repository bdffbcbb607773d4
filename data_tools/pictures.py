"""A folder of pictures of one camera, of which nothing else is known, as views.

    PATH/IMG_0001.jpg, IMG_0002.jpg, ...     PNG, JPEG or TIFF
    PATH/camera.json, or beside the folder   {"fx": 572.4, "fy": 573.6, "cx": 325.3, "cy": 242.0,
                                              "width": 640, "height": 480}

The camera is BOP's `camera.json`, or nothing but K: `{"K": ...}`, `{"cam_K": ...}` or the numbers
alone, in three rows of three or nine in a row. Width and height may be missing; where they are
given, pictures have that size.
"""

from __future__ import annotations

import io
import operator
import re
import warnings
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from PIL import Image, UnidentifiedImageError

from data_tools.bop.files import (
    IMAGE_SUFFIXES,
    has_file,
    read_bytes,
    read_grey,
    read_json,
    read_number,
    read_numbers,
    read_rgb,
)
from data_tools.views import Dataset, ModelSet, View
from posecore.arrays import fail

__all__ = ["CameraWarning", "PictureFolder", "read_camera"]

CAMERA = "camera.json"
DISTORTION = re.compile(r"d|dist(_?coeffs?)?|distortion\w*|k[1-6]|p[12]", re.IGNORECASE)
ORIENTATION = 274  # the tag of EXIF that says how a photograph is to be turned


class CameraWarning(UserWarning):
    """A camera that may not be the one of the pictures, or says more than is taken from it."""


class PictureFolder(Dataset):
    """The pictures of a folder, in the order of their names, numbers in these counted as numbers.

    A picture's `image_id` is the last number in its name, if all have one and no two the same;
    else its place in the folder, from 0. The `scene_id` is 0. Views have `rgb`, and `ir` where a
    picture is grey; they have no objects.

    Args:
        path: the folder. Other files in it are left alone.
        split: None.
        camera: the file of the camera; None for `camera.json` in the folder or beside it.

    Attributes:
        path, camera: as above.
        K: (3, 3) the camera matrix.
        files: the names of the pictures, in the order of the views.
        image_ids: of the pictures.

    Raises:
        ValueError: naming the argument or the file, if there are no pictures or no camera, or the
            camera is damaged.
    """

    def __init__(
        self, path: str | Path, split: str | None = None, *, camera: str | Path | None = None
    ) -> None:
        if not isinstance(path, str | Path) or not Path(path).is_dir():
            fail("path", "a folder of pictures", repr(path))
        if split is not None:
            expected = "None, as a folder of pictures has no parts, and no poses to train with"
            fail("split", expected, repr(split))
        self.path = Path(path)
        names = [p.name for p in self.path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES]
        self.files = sorted(names, key=_natural)
        if not self.files:
            fail("path", f"a folder with pictures ({', '.join(IMAGE_SUFFIXES)})", repr(str(path)))
        self.image_ids = _image_ids(self.files)
        self.camera = _find_camera(self.path) if camera is None else Path(camera)
        self.K, self._size = read_camera(self.camera)
        self._told: set[str] = set()

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> View:
        index = operator.index(index)
        file = self.path / self.files[index]
        try:
            grey = read_grey(file)
        except ValueError:  # coloured, or damaged, which is said below
            grey = None
        deep = grey is not None and grey.dtype != np.uint8
        rgb = None if deep else read_rgb(file)
        view = View(K=self.K, scene_id=0, image_id=self.image_ids[index], rgb=rgb, ir=grey)
        self._check(file, view)
        return view

    def __repr__(self) -> str:
        return f"PictureFolder({str(self.path)!r}: {len(self)} pictures)"

    @property
    def object_ids(self) -> tuple[int, ...]:
        """None: nobody has said what is in the pictures."""
        return ()

    def models(self) -> ModelSet:
        """Refuse, as pictures come without models.

        Raises:
            ValueError: always.
        """
        raise ValueError(f"{self.path}: no models: it is a folder of pictures")

    def _check(self, file: Path, view: View) -> None:
        """Refuse a picture of another size; warn once of what may be wrong with the camera."""
        height, width = view.shape
        if self._size is not None and (width, height) != self._size:
            size = "{} x {}".format(*self._size)
            raise ValueError(
                f"{file}: expected {size} pixels as {self.camera} has it, got {width} x {height}: "
                "posecore.cameras.resize_intrinsics makes the camera of resized pictures"
            )
        x, y = self.K[:2, 2]
        if not (0 <= x < width and 0 <= y < height):
            self._warn(
                f"{self.camera}: cx, cy = {x:.4g}, {y:.4g} lies outside pictures of {width} x "
                f"{height}: is it the camera of pictures of another size?"
            )
        if (turn := _orientation(file)) != 1:
            self._warn(
                f"{file}: the photograph is marked as to be turned (EXIF orientation {turn}); it "
                f"is taken as it is stored, {width} x {height}, and so must the camera be"
            )

    def _warn(self, text: str) -> None:
        kind = text.rpartition(": ")[2]
        if kind not in self._told:
            self._told.add(kind)
            warnings.warn(text, CameraWarning, stacklevel=4)


def read_camera(path: str | Path) -> tuple[np.ndarray, tuple[int, int] | None]:
    """Read a camera; the formats are those of the module.

    Args:
        path: a JSON file.

    Returns:
        `K` (3, 3), and (width, height) if the file has them.

    Raises:
        ValueError: naming the file and what is wrong in it.
    """
    where = str(path)
    try:
        content = read_json(Path(path))
    except FileNotFoundError:
        fail("camera", "a JSON file with fx, fy, cx and cy, or with K", repr(where))
    if isinstance(content, list):
        content = {"K": content}
    if not isinstance(content, dict):
        _refuse(where, content)
    key = next((k for k in ("K", "cam_K", "camera_matrix", "intrinsics") if k in content), None)
    if key is not None:
        K = _matrix(where, content, key)
    elif {"fx", "fy", "cx", "cy"} <= content.keys():
        fx, fy, cx, cy = (read_number(where, content, name) for name in ("fx", "fy", "cx", "cy"))
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    else:
        _refuse(where, sorted(content)[:6])
    try:
        View(K=K, scene_id=0, image_id=0)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    lens = [k for k, value in content.items() if DISTORTION.fullmatch(k) and np.any(value)]
    if lens:
        warnings.warn(
            f"{where}: lens distortion ({', '.join(lens)}) is not used: pictures must be "
            "undistorted, as cv2.undistort does it",
            CameraWarning,
            stacklevel=3,
        )
    if not {"width", "height"} <= content.keys():
        return K, None
    size = tuple(read_number(where, content, name) for name in ("width", "height"))
    if any(value < 1 or value != int(value) for value in size):
        raise ValueError(f"{where}: width, height: expected whole numbers above 0, got {size}")
    return K, (int(size[0]), int(size[1]))


def _matrix(where: str, content: dict[str, Any], key: str) -> np.ndarray:
    value = content[key]
    if isinstance(value, list) and len(value) == 3 and all(isinstance(row, list) for row in value):
        content = {key: [number for row in value for number in row]}
    return read_numbers(where, content, key, 9).reshape(3, 3)


def _refuse(where: str, got: object) -> NoReturn:
    raise ValueError(f"{where}: expected fx, fy, cx and cy, or K with nine numbers, got {got}")


def _find_camera(folder: Path) -> Path:
    for place in (folder, folder.resolve().parent):
        if has_file(place / CAMERA):
            return place / CAMERA
    fail("camera", f"a file, as there is no {CAMERA} in {folder} or beside it", "None")


def _natural(name: str) -> list[tuple[int, int, str]]:
    """For sorting: "2.png" before "10.png"."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+", name)
    return [(0, int(part), part) if part[0].isdigit() else (1, 0, part) for part in parts]


def _image_ids(files: list[str]) -> list[int]:
    numbers = [re.findall("[0-9]{1,18}", Path(name).stem) for name in files]
    ids = [int(found[-1]) for found in numbers if found]
    return ids if len(set(ids)) == len(files) else list(range(len(files)))


def _orientation(file: Path) -> int:
    try:
        with Image.open(io.BytesIO(read_bytes(file))) as picture:
            return picture.getexif().get(ORIENTATION, 1)
    except (UnidentifiedImageError, OSError, ValueError):
        return 1
