"""The surface at a pixel: where it is in the object and in the camera, and which way it looks.

Coordinates are kept as three separate arrays, x, y and z, which NumPy works through several times
faster than rows of three; and in float32, which has seven digits, where only pictures come of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.rasteriser import affine
from data_tools.renderer.visibility import Pose

__all__ = [
    "CHUNK",
    "Surface",
    "Triple",
    "camera_points",
    "dot",
    "face_normals",
    "normalised",
    "rotated",
    "surface_at",
]

CHUNK = 16384  # pixels worked on at a time, so that all their numbers stay in the processor's cache

Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """Points of one object's surface, each a triple of (P,) float32 arrays.

    Attributes:
        point: in the camera's frame, metres.
        coordinates: the same points in the object's frame.
        normal: shading normals in the camera's frame, on the side from which the face is seen.
        object_normal: in the object's frame, on the outer side.
        side: 1 for faces that the camera sees from outside, -1 for those it sees from behind.
    """

    point: Triple
    coordinates: Triple
    normal: Triple
    object_normal: Triple
    side: np.ndarray


def surface_at(
    prepared: PreparedMesh,
    pose: Pose,
    K: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    inverse_depth: np.ndarray,
    face: np.ndarray,
) -> Surface:
    """The surface that pixels see.

    Args:
        prepared: the object.
        pose: its (R, t).
        K: (3, 3) camera matrix.
        x, y: (P,) pixels, not necessarily whole numbers.
        inverse_depth: (P,) 1 / z.
        face: (P,) which of the prepared faces.
    """
    R, t = pose
    R_inverse = np.linalg.inv(R).astype(np.float32)
    point = camera_points(K, x, y, inverse_depth)
    shift = t.astype(np.float32)
    coordinates = rotated(R_inverse, tuple(c - s for c, s in zip(point, shift, strict=True)))
    N = prepared.normals[face].reshape(-1, 12).T
    X, Y, Z = coordinates
    outward = normalised(
        tuple(N[k] * X + N[k + 1] * Y + N[k + 2] * Z + N[k + 3] for k in (0, 4, 8))
    )
    side = _side(prepared, pose, face)
    normal = tuple(side * c for c in rotated(R.astype(np.float32), outward))
    return Surface(point, coordinates, normal, outward, side)


def camera_points(K: np.ndarray, x: np.ndarray, y: np.ndarray, inverse_depth: np.ndarray) -> Triple:
    """The points of the camera's frame that pixels see, float32 metres."""
    inverse = np.linalg.inv(K).astype(np.float32)
    z = (1 / inverse_depth).astype(np.float32)
    x, y = x.astype(np.float32), y.astype(np.float32)
    ray_x = inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2]
    ray_y = inverse[1, 1] * y + inverse[1, 2]
    return ray_x * z, ray_y * z, z


def face_normals(prepared: PreparedMesh, pose: Pose, face: np.ndarray, side: np.ndarray) -> Triple:
    """The normals of the flat faces in the camera's frame, on the `side` of the camera."""
    normal = tuple(row[face].astype(np.float32) for row in prepared.planes[:3])
    return tuple(side * c for c in rotated(pose[0].astype(np.float32), normal))


def _side(prepared: PreparedMesh, pose: Pose, face: np.ndarray) -> np.ndarray:
    """1 for faces that the camera sees from outside, -1 for those that it sees from behind."""
    R, t = pose
    planes = prepared.planes[:, face] if len(face) < prepared.planes.shape[1] else prepared.planes
    distance = affine((*-np.linalg.inv(R) @ t, 0.0), planes) + planes[3]
    side = np.where(distance < 0, np.float32(-1), np.float32(1))
    return side if planes is not prepared.planes else side[face]


def dot(a: Triple, b: Triple) -> np.ndarray:
    """The scalar products."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rotated(R: np.ndarray, x: Triple) -> Triple:
    """The vectors `R @ x`."""
    return tuple(R[k, 0] * x[0] + R[k, 1] * x[1] + R[k, 2] * x[2] for k in range(3))


def normalised(x: Triple) -> Triple:
    """The vectors at unit length; a zero vector stays zero."""
    scale = 1 / np.sqrt(np.maximum(dot(x, x), np.float32(1e-30)))
    return x[0] * scale, x[1] * scale, x[2] * scale
