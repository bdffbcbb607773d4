"""OpenGL's cameras, and Blender's and NeRF's, against this library's, which are OpenCV's.

Both look at the same world. OpenCV's camera frame has x right, y down, z forward; OpenGL's has x
right, y up, z backward, so that what is in front has z < 0. Both have the origin in the camera.
What OpenCV says with `K`, OpenGL says with a projection matrix onto a cube from -1 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from posecore.arrays import Array, array_function, fail, require_number, somewhere
from posecore.cameras import _require_size, require_intrinsics

__all__ = [
    "intrinsics_to_projection",
    "opencv_to_opengl",
    "opengl_to_opencv",
    "projection_to_intrinsics",
]


@array_function(R="... 3 3", t="... 3")
def opengl_to_opencv(R: Array, t: Array) -> tuple[Array, Array]:
    """The pose of an object in OpenCV's camera frame from that in OpenGL's (its model-view matrix).

    y and z change their signs: `F R` and `F t` with `F = diag(1, -1, -1)`. The object's own frame
    stays as it is.

    A camera's pose in the world (camera to world, the `transform_matrix` of NeRF and Blender) goes
    the other way; its inverse is the pose of the world in the camera:
    `opengl_to_opencv(*poses.invert(R_world_camera, t_world_camera))`.

    Args:
        R: (..., 3, 3) from object to OpenGL's camera frame.
        t: (..., 3) translation.

    Returns:
        `R` (..., 3, 3) and `t` (..., 3), from object to OpenCV's camera frame.
    """
    flip = R.new_tensor([1.0, -1.0, -1.0])
    return flip[:, None] * R, flip * t


@array_function(R="... 3 3", t="... 3")
def opencv_to_opengl(R: Array, t: Array) -> tuple[Array, Array]:
    """The pose of an object in OpenGL's camera frame from that in OpenCV's.

    The same two signs as in `opengl_to_opencv`, which says what becomes of a camera's own pose.

    Args:
        R: (..., 3, 3) from object to OpenCV's camera frame.
        t: (..., 3) translation.

    Returns:
        `R` (..., 3, 3) and `t` (..., 3), from object to OpenGL's camera frame.
    """
    return opengl_to_opencv(R, t)


@array_function(K="... 3 3")
def intrinsics_to_projection(K: Array, size: Sequence[int], near: float, far: float) -> Array:
    """OpenGL's projection matrix of a camera.

    Drawn with it, a point lands on the pixel that `cameras.project` says, if the picture is read
    with its first row on top. (`glReadPixels` gives the bottom row first.) OpenGL counts pixels
    from the border of the picture, OpenCV from the centre of the first: that half pixel is in it.

    Args:
        K: (..., 3, 3) camera matrix; skew is allowed.
        size: (width, height) of the picture in pixels.
        near, far: distances of the clipping planes, 0 < near < far; `far` may be infinite.

    Returns:
        (..., 4, 4) for columns of OpenGL's camera frame: `clip = P @ (x, y, z, 1)`.

    Raises:
        ValueError: if `K` is no camera matrix, or the size or the planes cannot be.
    """
    require_intrinsics("K", K)
    width, height = _require_size("size", size)
    near = require_number("near", near, above=0)
    if far != math.inf:
        far = require_number("far", far, above=near)
    P = K.new_zeros(*K.shape[:-2], 4, 4)
    P[..., 0, 0] = 2 * K[..., 0, 0] / width
    P[..., 0, 1] = -2 * K[..., 0, 1] / width
    P[..., 0, 2] = 1 - (2 * K[..., 0, 2] + 1) / width
    P[..., 1, 1] = 2 * K[..., 1, 1] / height
    P[..., 1, 2] = (2 * K[..., 1, 2] + 1) / height - 1
    ratio = near / far  # 0 for a plane at infinity
    P[..., 2, 2] = -(1 + ratio) / (1 - ratio)
    P[..., 2, 3] = -2 * near / (1 - ratio)
    P[..., 3, 2] = -1
    return P


@array_function(P="... 4 4")
def projection_to_intrinsics(P: Array, size: Sequence[int]) -> Array:
    """The camera of one of OpenGL's projection matrices, such as `gluPerspective` makes.

    Args:
        P: (..., 4, 4) perspective projection, columns multiplied from the right; some programs
            store the transpose.
        size: (width, height) of the picture in pixels.

    Returns:
        (..., 3, 3) camera matrix.

    Raises:
        ValueError: if `P` is no perspective projection: its last row is not 0 0 -1 0, an entry in
            the first two rows that a camera has not is not 0, or a focal length is 0.
    """
    width, height = _require_size("size", size)
    if somewhere(P[..., 3, :] != P.new_tensor([0.0, 0.0, -1.0, 0.0])):
        wrong = (P[..., 3, :] != P.new_tensor([0.0, 0.0, -1.0, 0.0])).any(-1)
        got = P[..., 3, :][wrong][0].tolist()
        fail("P", "a perspective projection, its last row 0 0 -1 0 (or is it the transpose?)", got)
    if somewhere(P[..., [0, 1, 1], [3, 0, 3]] != 0) or somewhere(P[..., [0, 1], [0, 1]] == 0):
        fail("P", "first rows (a, b, c, 0) and (0, d, e, 0), a and d not 0", "others")
    zero = torch.zeros_like(P[..., 0, 0])
    entries = [
        P[..., 0, 0] * width / 2,
        -P[..., 0, 1] * width / 2,
        ((1 - P[..., 0, 2]) * width - 1) / 2,
        zero,
        P[..., 1, 1] * height / 2,
        ((1 + P[..., 1, 2]) * height - 1) / 2,
        zero,
        zero,
        zero + 1,
    ]
    return torch.stack(entries, -1).unflatten(-1, (3, 3))
