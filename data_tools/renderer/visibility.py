"""Several objects in one image: the z-buffer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.rasteriser import NEAR, ObjectBuffer, rasterise
from posecore.arrays import fail, require_integer, require_number
from posecore.cameras import require_intrinsics
from posecore.rotations import require_rotation

__all__ = ["Pose", "Scene", "Visibility", "visibility"]

Pose = tuple[np.ndarray, np.ndarray]
"""(R, t) from object to camera: `X_cam = R @ X_obj + t`, metres."""

LARGEST = 16384  # pixels, the width or height of an image


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects before one camera, checked once.

    Attributes:
        objects: what is in the scene; one object may be there several times.
        poses: its place in the camera's frame, as many as objects.
        K: (3, 3) camera matrix in pixels.
        size: (width, height) of the image in pixels.
        near: metres; nothing closer to the camera is drawn.

    Raises:
        ValueError: naming the field that does not fit this description.
    """

    objects: Sequence[PreparedMesh]
    poses: Sequence[Pose]
    K: np.ndarray
    size: tuple[int, int]
    near: float = NEAR

    def __post_init__(self) -> None:
        objects, poses = list(self.objects), list(self.poses)
        for item in objects:
            if not isinstance(item, PreparedMesh):
                fail("objects", "prepared meshes (see `prepare`)", type(item).__name__)
        if len(poses) != len(objects):
            fail("poses", f"one for each of {len(objects)} objects", len(poses))
        if len(objects) > np.iinfo(np.int16).max:
            fail("objects", "no more than an int16 can number", len(objects))
        checked = [_pose(k, pose) for k, pose in enumerate(poses)]
        if checked:
            require_rotation("poses", np.stack([R for R, _ in checked]))
        K = _numbers("K", self.K, (3, 3))
        require_intrinsics("K", K)
        try:
            width, height = self.size
        except (TypeError, ValueError):
            fail("size", "(width, height)", repr(self.size))
        width = require_integer("size", width, 1, LARGEST)
        height = require_integer("size", height, 1, LARGEST)
        near = require_number("near", self.near, above=0)
        for name, value in (
            ("objects", tuple(objects)),
            ("poses", tuple(checked)),
            ("K", K),
            ("size", (width, height)),
            ("near", near),
        ):
            object.__setattr__(self, name, value)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image."""
        return self.size[::-1]


@dataclass(frozen=True, eq=False, repr=False)
class Visibility:
    """What each pixel sees.

    Attributes:
        instance: (H, W) int16 index of the object, -1 for none.
        face: (H, W) int32 index of its prepared face, 0 where there is no object.
        inverse_depth: (H, W) float64 1 / z in 1/m, 0 where there is no object.
        buffers: for each object what is seen of it alone, None if it covers no pixel.
    """

    instance: np.ndarray
    face: np.ndarray
    inverse_depth: np.ndarray
    buffers: tuple[ObjectBuffer | None, ...]


def visibility(scene: Scene, *, outside: bool = False) -> Visibility:
    """Draw all objects of a scene; of two at the same depth the first is seen.

    Args:
        scene: objects, poses and camera.
        outside: count the pixels of silhouettes outside the image as well.
    """
    instance = np.full(scene.shape, -1, np.int16)
    face = np.zeros(scene.shape, np.int32)
    nearest = np.zeros(scene.shape)
    buffers = []
    for index, (item, (R, t)) in enumerate(zip(scene.objects, scene.poses, strict=True)):
        buffer = rasterise(item, R, t, scene.K, scene.size, near=scene.near, outside=outside)
        buffers.append(buffer)
        if buffer is None:
            continue
        window, inverse_depth = buffer.window, buffer.inverse_depth
        before = inverse_depth > nearest[window]
        np.copyto(nearest[window], inverse_depth, where=before)
        np.copyto(instance[window], np.int16(index), where=before)
        np.copyto(face[window], buffer.face, where=before, casting="same_kind")
    return Visibility(instance, face, nearest, tuple(buffers))


def _pose(index: int, pose: Pose) -> Pose:
    try:
        R, t = pose
    except (TypeError, ValueError):
        fail(f"poses[{index}]", "a pair (R, t)", repr(pose))
    return _numbers(f"poses[{index}] R", R, (3, 3)), _numbers(f"poses[{index}] t", t, (3,))


def _numbers(name: str, values: object, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError):
        fail(name, f"numbers of shape {shape}", repr(values))
    if array.shape != shape:
        fail(name, f"shape {shape}", f"shape {array.shape}")
    if not np.isfinite(array).all():
        fail(name, "finite numbers", array.tolist())
    return array
