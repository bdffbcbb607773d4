"""Rotations: representations, the way between them, distances, samples and means."""

from posecore.rotations.conversions import (
    axis_angle_to_matrix,
    axis_angle_to_quaternion,
    matrix_to_axis_angle,
    matrix_to_quaternion,
    matrix_to_rotation_6d,
    quaternion_multiply,
    quaternion_to_axis_angle,
    quaternion_to_matrix,
    rotation_6d_to_matrix,
)
from posecore.rotations.euler import euler_to_matrix, matrix_to_euler
from posecore.rotations.procrustes import special_procrustes
from posecore.rotations.quaternions import (
    quaternion_apply,
    quaternion_inverse,
    quaternion_slerp,
    slerp,
    wxyz_to_xyzw,
    xyzw_to_wxyz,
)
from posecore.rotations.so3 import (
    geodesic_distance,
    hat,
    mean_rotation,
    random_rotations,
    vee,
)
from posecore.rotations.validity import (
    is_rotation,
    require_rotation,
    rotation_defect,
)

__all__ = [
    "axis_angle_to_matrix",
    "axis_angle_to_quaternion",
    "euler_to_matrix",
    "geodesic_distance",
    "hat",
    "is_rotation",
    "matrix_to_axis_angle",
    "matrix_to_euler",
    "matrix_to_quaternion",
    "matrix_to_rotation_6d",
    "mean_rotation",
    "quaternion_apply",
    "quaternion_inverse",
    "quaternion_multiply",
    "quaternion_slerp",
    "quaternion_to_axis_angle",
    "quaternion_to_matrix",
    "random_rotations",
    "require_rotation",
    "rotation_6d_to_matrix",
    "rotation_defect",
    "slerp",
    "special_procrustes",
    "vee",
    "wxyz_to_xyzw",
    "xyzw_to_wxyz",
]
