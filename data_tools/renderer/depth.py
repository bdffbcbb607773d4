"""Depth of one object alone, as metrics compare it with what a sensor saw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data_tools.renderer.prepared import PreparedMesh, prepare
from data_tools.renderer.rasteriser import NEAR, rasterise
from data_tools.renderer.visibility import LARGEST, Pose, _pose
from data_tools.shapes.mesh import Material, Mesh
from posecore.arrays import fail, require_integer, require_number, to_numbers
from posecore.cameras import require_intrinsics

__all__ = ["DepthWindow", "prepare_surface", "render_depth"]

FARTHEST = 1e6  # metres: what is beyond covers no pixel, and its pixels would overflow


class DepthWindow(NamedTuple):
    """The part of a depth image that holds an object.

    Attributes:
        x, y: column and row in the image of its first pixel.
        depth: (h, w) float64 z along the optical axis in metres, 0 where the object is not; empty
            if it covers no pixel of the image.
    """

    x: int
    y: int
    depth: np.ndarray

    def within(self, box: tuple[int, int, int, int]) -> np.ndarray:
        """The same in a larger window `box` (x, y, width, height): (height, width)."""
        x, y, width, height = box
        image = np.zeros((height, width))
        rows, columns = self.depth.shape
        image[self.y - y : self.y - y + rows, self.x - x : self.x - x + columns] = self.depth
        return image


def prepare_surface(vertices: np.ndarray, faces: np.ndarray) -> PreparedMesh:
    """A mesh of which only the depth is drawn, backs of faces as well as fronts.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) indices, at least one.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    vertices, faces = to_numbers("vertices", vertices), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        fail("vertices", "shape (V, 3)", f"shape {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces) or faces.dtype.kind not in "iu":
        fail("faces", "indices (F, 3), at least one", f"{faces.dtype} {faces.shape}")
    count = len(faces)
    return prepare(
        Mesh(
            name="surface",
            vertices=vertices,
            faces=faces.astype(np.int32),
            corner_normals=np.zeros((count, 3, 3), np.float32),  # nothing is shaded
            material=np.zeros(count, np.int16),
            materials=(Material(colour=(0.5, 0.5, 0.5)),),
            closed=np.zeros(count, bool),
        )
    )


def render_depth(
    item: PreparedMesh,
    pose: Pose,
    K: np.ndarray,
    size: tuple[int, int],
    *,
    near: float = NEAR,
) -> DepthWindow:
    """The depth of one object with nothing else in the scene, exact to ten digits.

    Args:
        item: the object.
        pose: its (R, t) from object to camera, metres. R may be any matrix that has an inverse, as
            published ground truth is not always exactly a rotation.
        K: (3, 3) camera matrix; the centre of the first pixel is (0, 0).
        size: (width, height) of the image in pixels.
        near: metres; surfaces are cut where they come closer to the camera.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    if not isinstance(item, PreparedMesh):
        fail("item", "a prepared mesh (see `prepare`)", type(item).__name__)
    R, t = _pose(0, pose)
    K = to_numbers("K", K)
    require_intrinsics("K", K)
    width, height = (require_integer("size", length, 1, LARGEST) for length in size)
    near = require_number("near", near, above=0)
    if not abs(np.linalg.det(R)) > 1e-6:
        fail("poses[0] R", "a matrix that has an inverse", R.tolist())
    buffer = None
    if np.abs(t).max() < FARTHEST:
        buffer = rasterise(item, R, t, K, (width, height), near=near, outside=False)
    if buffer is None or not buffer.keys.size:
        return DepthWindow(0, 0, np.zeros((0, 0)))
    inverse = buffer.inverse_depth
    seen = buffer.mask
    depth = np.zeros(inverse.shape)
    depth[seen] = 1 / inverse[seen]
    return DepthWindow(buffer.x, buffer.y, depth)
