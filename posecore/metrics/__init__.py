"""Metrics: errors of single poses, overlap of boxes, and what is made of many errors."""

from posecore.metrics.boxes import box_corners, nocs_legacy_iou, oriented_iou_3d
from posecore.metrics.detection import average_precision, match_by_error, match_by_overlap
from posecore.metrics.model_errors import add, add_s, mspd, mssd, projection_2d
from posecore.metrics.overlaps import box_iou_2d, mask_iou
from posecore.metrics.pose_errors import axis_error, rotation_error, translation_error
from posecore.metrics.pose_table import PoseTable
from posecore.metrics.summaries import (
    accuracy,
    accuracy_curve,
    angle_difference,
    auc,
    average_recall,
    balanced_mean_angular_error,
    mean_absolute_error,
    root_mean_squared_error,
    within,
)
from posecore.symmetry import closest_symmetry

__all__ = [
    "PoseTable",
    "accuracy",
    "accuracy_curve",
    "add",
    "add_s",
    "angle_difference",
    "auc",
    "average_precision",
    "average_recall",
    "axis_error",
    "balanced_mean_angular_error",
    "box_corners",
    "box_iou_2d",
    "closest_symmetry",
    "mask_iou",
    "match_by_error",
    "match_by_overlap",
    "mean_absolute_error",
    "mspd",
    "mssd",
    "nocs_legacy_iou",
    "oriented_iou_3d",
    "projection_2d",
    "root_mean_squared_error",
    "rotation_error",
    "translation_error",
    "within",
]
