"""Metrics: errors of single poses, overlap of boxes, and what is made of many errors."""

from posecore.metrics import matching, report
from posecore.metrics.bop_errors import Present, SurfaceErrors, add_bop_errors
from posecore.metrics.bop_scores import (
    average_precisions,
    average_recalls,
    detection_precision,
    time_per_image,
)
from posecore.metrics.boxes import box_corners, nocs_legacy_iou, oriented_iou_3d, turned_iou_3d
from posecore.metrics.categories import (
    Similarity,
    instance_rotation_error,
    nocs_axes,
    split_similarity,
)
from posecore.metrics.category_evaluation import CategoryErrors, evaluate_categories
from posecore.metrics.category_report import report_categories
from posecore.metrics.detection import (
    Detections,
    average_precision,
    coco_average_precision,
    match_at_thresholds,
    match_by_error,
    match_by_overlap,
    pair_at_thresholds,
    pair_by_overlap,
)
from posecore.metrics.evaluation import ObjectErrors, evaluate
from posecore.metrics.matching import in_images, match
from posecore.metrics.model_errors import add, add_s, mspd, mssd, projection_2d
from posecore.metrics.overlaps import box_iou_2d, mask_iou
from posecore.metrics.pose_errors import axis_error, rotation_error, translation_error
from posecore.metrics.pose_table import CategoryPoseTable, PoseTable
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
from posecore.metrics.visible_surface import distance_image, visible_surface, vsd
from posecore.symmetry import closest_symmetry

__all__ = [
    "CategoryErrors",
    "CategoryPoseTable",
    "Detections",
    "ObjectErrors",
    "PoseTable",
    "Present",
    "Similarity",
    "SurfaceErrors",
    "accuracy",
    "accuracy_curve",
    "add",
    "add_bop_errors",
    "add_s",
    "angle_difference",
    "auc",
    "average_precision",
    "average_precisions",
    "average_recall",
    "average_recalls",
    "axis_error",
    "balanced_mean_angular_error",
    "box_corners",
    "box_iou_2d",
    "closest_symmetry",
    "coco_average_precision",
    "detection_precision",
    "distance_image",
    "evaluate",
    "evaluate_categories",
    "in_images",
    "instance_rotation_error",
    "mask_iou",
    "match",
    "match_at_thresholds",
    "match_by_error",
    "match_by_overlap",
    "matching",
    "mean_absolute_error",
    "mspd",
    "mssd",
    "nocs_axes",
    "nocs_legacy_iou",
    "oriented_iou_3d",
    "pair_at_thresholds",
    "pair_by_overlap",
    "projection_2d",
    "report",
    "report_categories",
    "root_mean_squared_error",
    "rotation_error",
    "split_similarity",
    "time_per_image",
    "translation_error",
    "turned_iou_3d",
    "visible_surface",
    "vsd",
    "within",
]
