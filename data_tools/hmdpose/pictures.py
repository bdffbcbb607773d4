"""The images of a split: where they lie, that none is missing, and reduced ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from data_tools.bop.files import IMAGE_SUFFIXES, has_folder, read_depth, read_grey, read_mask
from data_tools.hmdpose.calibration import CAMERAS, Camera
from data_tools.hmdpose.tables import OBJECTS, Poses
from data_tools.linemod.folders import Numbered

__all__ = ["Pictures"]

MASKS = ("masks", "full_masks")


class Pictures:
    """The images of a split by kind, camera and frame.

    Args:
        folder: of the split.
        poses: of the split; the three images of every row must be there, and no others.
        table: the file of the poses, for messages.

    Attributes:
        kinds: of labels that are there: "depth", and pairs such as ("masks", "head").

    Raises:
        ValueError: naming the folder that is missing, or the row and the image.
    """

    def __init__(self, folder: Path, poses: Poses, table: Path) -> None:
        self.folder = folder
        places: dict[object, Path] = {"ir": folder}
        if has_folder(folder / "depth"):
            places["depth"] = folder / "depth"
        for kind in MASKS:
            for name in OBJECTS if has_folder(folder / kind) else ():
                if has_folder(folder / kind / name):
                    places[kind, name] = folder / kind / name
        self.kinds = frozenset(places) - {"ir"}
        self._files = {
            (kind, camera): Numbered(place / camera, IMAGE_SUFFIXES)
            for kind, place in places.items()
            for camera in CAMERAS
        }
        for files in self._files.values():
            _compare(files, poses, table)

    def grey(self, camera: str, frame: int, own: Camera, shown: Camera) -> np.ndarray:
        """(H, W) uint8 or uint16, of the size of `shown`; the file has that of `own`.

        Raises:
            ValueError: naming the file that is damaged, or of another size.
        """
        path = self._files["ir", camera][frame]
        image = _of_size(path, read_grey(path), own)
        return _resized(image, shown, cv2.INTER_AREA)

    def depth(
        self, camera: str, frame: int, own: Camera, shown: Camera, step: float
    ) -> np.ndarray | None:
        """(H, W) float32 metres, None without such images; errors as for `grey`."""
        if "depth" not in self.kinds:
            return None
        path = self._files["depth", camera][frame]
        units = _of_size(path, read_depth(path, 1000.0), own)
        # The nearest pixel: a mean of two surfaces would be one that is not there.
        return _resized(units, shown, cv2.INTER_NEAREST_EXACT) * np.float32(step)

    def mask(
        self, kind: str, name: str, camera: str, frame: int, own: Camera, shown: Camera
    ) -> np.ndarray | None:
        """(H, W) bool, None without such masks; errors as for `grey`.

        Args:
            kind: "masks" or "full_masks".
            name: "glasses" or "head".
            camera, frame, own, shown: as for `grey`. A pixel of a reduced mask is one that is
                covered by half or more.
        """
        if (kind, name) not in self.kinds:
            return None
        path = self._files[(kind, name), camera][frame]
        mask = _of_size(path, read_mask(path), own)
        if mask.shape == (shown.height, shown.width):
            return mask
        return _resized(mask.astype(np.float32), shown, cv2.INTER_AREA) >= 0.5


def _compare(files: Numbered, poses: Poses, table: Path) -> None:
    """Refuse rows without an image, and images without a row."""
    there, wanted = files.numbers, poses.frame.tolist()
    if lost := sorted(set(wanted) - set(there)):
        line = int(poses.lines[wanted.index(lost[0])])
        more = f" and of {len(lost) - 1} others" if len(lost) > 1 else ""
        raise ValueError(
            f"{table}: line {line}: no image of frame {lost[0]}{more} in {files.folder}"
        )
    if others := sorted(set(there) - set(wanted)):
        more = f" and for {len(others) - 1} others" if len(others) > 1 else ""
        raise ValueError(f"{table}: no row for {files[others[0]]}{more}")


def _of_size(path: Path, image: np.ndarray, camera: Camera) -> np.ndarray:
    height, width = image.shape
    if (width, height) != (camera.width, camera.height):
        raise ValueError(
            f"{path}: expected {camera.width} x {camera.height} pixels as in calibration.json, "
            f"got {width} x {height}"
        )
    return image


def _resized(image: np.ndarray, camera: Camera, interpolation: int) -> np.ndarray:
    if image.shape == (camera.height, camera.width):
        return image
    return cv2.resize(image, (camera.width, camera.height), interpolation=interpolation)
