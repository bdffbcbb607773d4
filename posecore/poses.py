"""Rigid transforms: a pose is a pair `(R, t)` that takes a point of the object to the camera.

`X_cam = R @ X_obj + t`, with `R` (..., 3, 3) and `t` (..., 3) in metres. Two poses are combined in
the order in which matrices are written: `compose(R_ab, t_ab, R_bc, t_bc)` maps from c to a.
"""

from __future__ import annotations

import numpy as np

from posecore.arrays import Array, array_function, fail, somewhere
from posecore.rotations import require_rotation

__all__ = ["apply", "compose", "from_matrix", "invert", "relative", "to_matrix"]


@array_function(R="... 3 3", t="... 3", points="... N 3", scale="...")
def apply(R: Array, t: Array, points: Array, scale: Array | float | None = None) -> Array:
    """Move points by a pose, `R @ x + t`, or by a similarity, `scale * R @ x + t`.

    `R` may be any matrix: published ground truth is not always exactly a rotation.

    Args:
        R: (..., 3, 3) rotation from object to camera.
        t: (..., 3) translation, in the unit of `points`.
        points: (..., N, 3) points in the object's frame.
        scale: (...) factor of a similarity transform, as `registration.umeyama` gives it.

    Returns:
        (..., N, 3) points in the camera's frame.
    """
    moved = points @ R.mT
    if scale is not None:
        moved = scale[..., None, None] * moved
    return moved + t[..., None, :]


@array_function(R_ab="... 3 3", t_ab="... 3", R_bc="... 3 3", t_bc="... 3")
def compose(R_ab: Array, t_ab: Array, R_bc: Array, t_bc: Array) -> tuple[Array, Array]:
    """Chain two poses: first (R_bc, t_bc), then (R_ab, t_ab).

    Args:
        R_ab, t_ab: (..., 3, 3) and (..., 3), the pose of frame b in frame a.
        R_bc, t_bc: (..., 3, 3) and (..., 3), the pose of frame c in frame b.

    Returns:
        `R_ac` (..., 3, 3) and `t_ac` (..., 3), the pose of frame c in frame a.
    """
    R_ac = R_ab @ R_bc
    t_ac = (R_ab @ t_bc[..., None])[..., 0] + t_ab
    return R_ac, t_ac


@array_function(R="... 3 3", t="... 3")
def invert(R: Array, t: Array) -> tuple[Array, Array]:
    """The pose of the camera in the object's frame: `(R^T, -R^T t)`.

    Args:
        R: (..., 3, 3) rotation.
        t: (..., 3) translation.

    Raises:
        ValueError: if `R` is not a rotation to 1e-3; the transpose is no inverse then.
    """
    require_rotation("R", R)
    return R.mT.clone(), -(R.mT @ t[..., None])[..., 0]


@array_function(R_1="... 3 3", t_1="... 3", R_2="... 3 3", t_2="... 3")
def relative(R_1: Array, t_1: Array, R_2: Array, t_2: Array) -> tuple[Array, Array]:
    """The pose (R, t) of the second frame in the first: `compose(R_1, t_1, R, t) = (R_2, t_2)`.

    Args:
        R_1, t_1: (..., 3, 3) and (..., 3), for example the pose of a camera in the world.
        R_2, t_2: (..., 3, 3) and (..., 3), for example the pose of an object in the same world.

    Returns:
        (..., 3, 3) and (..., 3); in the example, the pose of the object in the camera.

    Raises:
        ValueError: if `R_1` is not a rotation to 1e-3.
    """
    require_rotation("R_1", R_1)
    return R_1.mT @ R_2, (R_1.mT @ (t_2 - t_1)[..., None])[..., 0]


@array_function(R="... 3 3", t="... 3")
def to_matrix(R: Array, t: Array) -> Array:
    """The pose as one homogeneous matrix (..., 4, 4), last row 0 0 0 1."""
    batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = R.new_zeros(*batch, 4, 4)
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1
    return T


@array_function(T="... 4 4")
def from_matrix(T: Array) -> tuple[Array, Array]:
    """Split a homogeneous matrix (..., 4, 4) into `R` (..., 3, 3) and `t` (..., 3).

    Raises:
        ValueError: if the last row is not 0 0 0 1.
    """
    last = T.new_tensor([0.0, 0.0, 0.0, 1.0])
    if somewhere(T[..., 3, :] != last):
        wrong = (T[..., 3, :] != last).any(-1)
        fail("T", "a last row 0 0 0 1", T[..., 3, :][wrong][0].tolist())
    return T[..., :3, :3].clone(), T[..., :3, 3].clone()
