"""VSD of many poses: models are drawn, and compared with the depth images of a dataset."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from data_tools.bop import BopDataset
from data_tools.bop.pieces import read_depth_image
from data_tools.renderer import DepthWindow, prepare_surface, render_depth
from data_tools.views import ModelSet
from posecore import cameras, metrics
from posecore.arrays import fail
from posecore.metrics import PoseTable
from posecore.metrics.visible_surface import VSD_DELTA, VSD_TAUS

__all__ = ["DatasetSurfaces"]

Pose = tuple[np.ndarray, np.ndarray]


class DatasetSurfaces:
    """Measures VSD in the images of a dataset, as `bop_errors.SurfaceErrors` says.

    Each pose is drawn once, and only where it is in the image; each depth image is read once.
    Models are drawn with the backs of their faces, as BOP's renderer draws them. The centre of the
    first pixel is at (0, 0), as everywhere here; that renderer has it at (0.5, 0.5), against the
    rest of the toolkit, so its scores may differ a little.

    Args:
        dataset: with depth images.
        models: the objects' meshes.
        diameters: object id -> metres, of the objects that are measured.
        delta: metres that a surface may lie behind what was measured and yet be seen.

    Attributes:
        object_ids: those of `diameters` whose mesh has faces.
    """

    def __init__(
        self,
        dataset: BopDataset,
        models: ModelSet,
        diameters: Mapping[int, float],
        delta: float = VSD_DELTA,
    ) -> None:
        self.dataset = dataset
        self.diameters = dict(diameters)
        self.delta = delta
        meshes = {i: models.mesh(i) for i in diameters}
        self._items = {
            i: prepare_surface(mesh.vertices, mesh.faces)
            for i, mesh in meshes.items()
            if len(mesh.faces)
        }
        self.object_ids = frozenset(self._items)

    def __call__(self, estimates: PoseTable, truth: PoseTable) -> np.ndarray:
        """VSD of pairs of rows, in any order.

        Args:
            estimates, truth: (P rows), each pair of one object in one image.

        Returns:
            (P, T) errors for `VSD_TAUS`.

        Raises:
            ValueError: if an image has no depth image, or a damaged one.
        """
        errors = np.ones((len(truth), len(VSD_TAUS)))
        images: dict[tuple[int, int], list[int]] = {}
        for row, image in enumerate(truth.images):
            images.setdefault(image, []).append(row)
        for image, rows in sorted(images.items()):
            depth = read_depth_image(self.dataset, *image)
            if depth is None:
                fail("dataset", "depth images", f"none of scene {image[0]}")
            camera = self.dataset.camera(*image).K
            drawn: dict[tuple, DepthWindow] = {}
            for row in rows:
                object_id = int(truth.object_id[row])
                windows = []
                for table in (estimates, truth):
                    pose = table.R[row], table.t[row]
                    key = object_id, *(x.tobytes() for x in pose)
                    if key not in drawn:
                        item, size = self._items[object_id], depth.shape[::-1]
                        drawn[key] = render_depth(item, pose, camera, size)
                    windows.append(drawn[key])
                errors[row] = self._error(windows, depth, camera, self.diameters[object_id])
        return errors

    def _error(
        self, windows: list[DepthWindow], depth: np.ndarray, K: np.ndarray, diameter: float
    ) -> np.ndarray:
        """(T,) of one pair; 1 where the two cover no pixel together."""
        starts = np.array([(window.x, window.y) for window in windows])
        ends = starts + [window.depth.shape[::-1] for window in windows]
        if (starts.max(0) >= ends.min(0)).any():
            return np.ones(len(VSD_TAUS))
        (x, y), (width, height) = starts.min(0), ends.max(0) - starts.min(0)
        estimate, truth = (window.within((x, y, width, height)) for window in windows)
        return metrics.vsd(
            estimate,
            truth,
            depth[y : y + height, x : x + width],
            cameras.crop_intrinsics(K, float(x), float(y)),
            diameter,
            self.delta,
        )
