"""Figures: curves, pictures with poses drawn in, point clouds, and a 3D viewer for pages."""

from posecore.figures import photographs, results
from posecore.figures.charts import chart, draw_chart
from posecore.figures.clouds3d import point_clouds
from posecore.figures.curves import accuracy_curves, error_histogram
from posecore.figures.images import picture, picture_grid, pose_picture
from posecore.figures.live import training_curves
from posecore.figures.overlays import (
    draw_axes,
    draw_box,
    draw_ellipse,
    draw_keypoints,
    draw_outline,
)
from posecore.figures.style import Picture
from posecore.figures.viewer import Viewer

__all__ = [
    "Picture",
    "Viewer",
    "accuracy_curves",
    "chart",
    "draw_axes",
    "draw_box",
    "draw_chart",
    "draw_ellipse",
    "draw_keypoints",
    "draw_outline",
    "error_histogram",
    "photographs",
    "picture",
    "picture_grid",
    "point_clouds",
    "pose_picture",
    "results",
    "training_curves",
]
