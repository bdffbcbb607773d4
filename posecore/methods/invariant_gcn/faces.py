"""The six faces of an object's box, as each point sees them, and what the points make of them.

Source: Di et al., "GPV-Pose", CVPR 2022, Section 3.4; Chen et al., the rotation-invariant paper,
Section 3.3.3, Eq. 9 and 11. A plane is the points x with N . x = D, N outward.
"""

from __future__ import annotations

import torch

from posecore.arrays import Array, array_function, fail, somewhere
from posecore.registration import Plane, fit_plane

__all__ = [
    "FACES",
    "face_distances",
    "face_points",
    "outward_normals",
    "voted_faces",
]

FACES = ("x+", "y+", "z+", "x-", "y-", "z-")
"""In the order in which all arrays have them."""


@array_function(R="... 3 3")
def outward_normals(R: Array) -> Array:
    """r_i of all faces: the columns of the rotation, then the same with the other sign.

    Args:
        R: (..., 3, 3) rotation from object to camera.

    Returns:
        (..., 6, 3) unit vectors in the camera's frame.
    """
    return torch.cat([R.mT, -R.mT], -2)


@array_function(points="... N 3", R="... 3 3", t="... 3", size="... 3")
def face_distances(points: Array, R: Array, t: Array, size: Array) -> Array:
    """How far each point is from each face, along its normal: f = s / 2 - r^T (p - t), Eq. 11.

    As printed a vector is subtracted from a number, and all faces have the sign of the first three.

    Args:
        points: (..., N, 3) metres in the camera's frame.
        R: (..., 3, 3) rotation from object to camera.
        t: (..., 3) metres, the middle of the box.
        size: (..., 3) metres, its edges.

    Returns:
        (..., N, 6) metres, negative outside the box.
    """
    ahead = (points - t[..., None, :]) @ R  # R^T (p - t), of each point
    half = size[..., None, :] / 2
    return torch.cat([half - ahead, half + ahead], -1)


@array_function(points="... N 3", normals="... N 6 3", distances="... N 6")
def face_points(points: Array, normals: Array, distances: Array) -> Array:
    """Where each point takes each face to be: p' = p + n d, Eq. 9.

    Args:
        points: (..., N, 3) metres.
        normals: (..., N, 6, 3) directions to the faces.
        distances: (..., N, 6) metres along them.

    Returns:
        (..., N, 6, 3) metres.
    """
    return points[..., None, :] + normals * distances[..., None]


@array_function(points="... N 3", normals="... N 6 3", distances="... N 6", confidences="... N 6")
def voted_faces(points: Array, normals: Array, distances: Array, confidences: Array) -> Plane:
    """The six planes that the points vote for, each point by its confidence.

    Args:
        points: (..., N, 3) metres.
        normals: (..., N, 6, 3) directions to the faces; their mean by confidence says which side of
            a plane is outward.
        distances: (..., N, 6) metres along them.
        confidences: (..., N, 6) none negative, not all zero.

    Returns:
        A `Plane`: normals (..., 6, 3) and offsets (..., 6), metres.

    Raises:
        ValueError: if a confidence is negative, or all of a face's are zero.
    """
    if somewhere(confidences < 0) or somewhere(confidences.sum(-2) == 0):
        fail("confidences", "none negative, some above 0 for each face", float(confidences.min()))
    votes = face_points(points, normals, distances).transpose(-3, -2)  # (..., 6, N, 3)
    weights = confidences.transpose(-1, -2)  # (..., 6, N)
    outward = (weights[..., None] * normals.transpose(-3, -2)).sum(-2)
    return fit_plane(votes, weights, outward)
