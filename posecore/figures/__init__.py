"""Figures: curves, pictures with poses drawn in, point clouds, and a 3D viewer for pages."""

from posecore.figures import encoding, photographs, results, scene, style
from posecore.figures.charts import chart, draw_chart
from posecore.figures.clouds3d import draw_scene, point_clouds
from posecore.figures.curves import accuracy_curves, error_histogram
from posecore.figures.images import picture, picture_grid, pose_picture
from posecore.figures.live import Display, Recorded, training_curves
from posecore.figures.overlays import (
    box_edges,
    draw_axes,
    draw_box,
    draw_ellipse,
    draw_keypoints,
    draw_outline,
)
from posecore.figures.style import Picture
from posecore.figures.viewer import Viewer

__all__ = [
    "Display",
    "Picture",
    "Recorded",
    "Viewer",
    "accuracy_curves",
    "box_edges",
    "chart",
    "draw_axes",
    "draw_box",
    "draw_chart",
    "draw_ellipse",
    "draw_keypoints",
    "draw_outline",
    "draw_scene",
    "encoding",
    "error_histogram",
    "photographs",
    "picture",
    "picture_grid",
    "point_clouds",
    "pose_picture",
    "results",
    "scene",
    "style",
    "training_curves",
]
