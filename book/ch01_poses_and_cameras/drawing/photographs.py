"""The pictures of chapter 1, real where the data is at hand, drawn otherwise, and what all share.

True poses are drawn in blue, estimates in orange, on every picture of the chapter.
"""

import os
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes

import data_tools
from book.ch01_poses_and_cameras.drawing import stand_in
from data_tools.bop.files import read_rgb
from data_tools.bop.results import read_results
from posecore import cameras, poses
from posecore.figures.style import COLOURS
from posecore.metrics.evaluation import match
from posecore.rotations import special_procrustes

__all__ = ["ESTIMATE", "TRUTH", "Photograph", "pale", "photograph", "real_results", "scan", "zoom"]

Photograph = stand_in.Photograph
TRUTH, ESTIMATE = COLOURS[0], COLOURS[1]
SCAN_POINTS = 5000  # two or three millimetres apart


def photograph(real_data: str | Path | None = None) -> Photograph:
    """A photograph of an object whose pose is known.

    Args:
        real_data: the folder with `linemod_cat`; by default what POSECORE_DATA says. Without it
            the drawn stand-in.
    """
    folder = _real_data(real_data)
    if folder is None:
        return stand_in.photograph()
    folder = folder / "linemod_cat"
    R, t = np.split(np.load(folder / "cat_pose.npy").astype(np.float64), [3], axis=1)
    keypoints = np.loadtxt(folder / "cat_points_3d.txt")
    corners = np.loadtxt(folder / "cat_bb8_3d.txt")
    return Photograph(
        name="cat",
        source="a photograph of LINEMOD",
        rgb=read_rgb(folder / "cat.jpg"),
        K=np.array([[572.4114, 0, 325.2611], [0, 573.57043, 242.04899], [0, 0, 1]]),
        R=R,
        t=t[:, 0],
        keypoints=keypoints,
        points=keypoints,
        size=np.ptp(corners, axis=0),
        centre=corners.mean(0),
        diameter=float(np.linalg.norm(np.ptp(corners, axis=0))),
        mask=read_rgb(folder / "cat_mask.png")[..., 0] > 0,
    )


def scan(real_data: str | Path | None = None) -> Photograph:
    """A picture with depth, of an object whose mesh is known; arguments as in `photograph`."""
    folder = _real_data(real_data)
    if folder is None:
        return stand_in.photograph(points=SCAN_POINTS)
    # As read, and the one pose projected here: other objects' poses, slightly off, are not used.
    dataset = data_tools.open(f"bop:{folder / 'lmo'}", split="test", rotations="as_read")
    view, mesh = dataset[0], dataset.models().mesh(5)
    can = next(item for item in view.objects if item.object_id == 5)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    points, normals = stand_in.sample_surface(vertices, faces, SCAN_POINTS)
    R = special_procrustes(can.R)
    there = poses.apply(R, can.t, vertices)
    height, width = view.depth.shape
    drawn, face, _ = stand_in.rasterise(view.K, there, faces, (width, height))
    # The data has no masks: the can is where the depth is near that of the model at its true pose.
    mask = (face >= 0) & (np.abs(view.depth - drawn) < 0.02)
    keypoints = np.vstack([points[:8], np.ptp(vertices, axis=0) / 2 + vertices.min(0)])
    return Photograph(
        name="can",
        source="a frame of LINEMOD-Occlusion",
        rgb=view.rgb,
        K=view.K,
        R=R,
        t=can.t,
        keypoints=keypoints,
        points=points,
        normals=normals,
        size=np.ptp(vertices, axis=0),
        centre=vertices.min(0) + np.ptp(vertices, axis=0) / 2,
        diameter=float(dataset.models().info(5).diameter),
        mask=mask,
        depth=view.depth,
        vertices=vertices,
        faces=faces,
    )


def real_results(
    real_data: str | Path | None = None,
) -> tuple[np.ndarray, np.ndarray] | None:
    """MegaPose's rotations (N, 3, 3) for the can of LM-O and the ground truth's, as published.

    The top-scoring estimate of every image, both as read: the ground truth is not orthonormal. None
    without `bop_results` in the folder that `real_data` or POSECORE_DATA says.
    """
    folder = _real_data(real_data)
    if folder is None:
        return None
    files = [folder / "bop_results" / f"{name}_lmo-test.csv" for name in ("megapose", "gt")]
    estimates, truth = (read_results(path, rotations="as_read") for path in files)
    truth = truth[truth.object_id == 5]
    rows = match(estimates, truth)
    return estimates[rows[rows >= 0]].R, truth[rows >= 0].R


def _real_data(folder: str | Path | None) -> Path | None:
    folder = folder or os.environ.get("POSECORE_DATA")
    return Path(folder) if folder else None


def pale(photo: Photograph) -> np.ndarray:
    """The photograph as a background, grey and bright, so that lines stand out."""
    grey = cv2.cvtColor(photo.rgb, cv2.COLOR_RGB2GRAY)
    return np.repeat(np.uint8(92 + 0.63 * grey)[..., None], 3, 2)


def zoom(axes: Axes, photo: Photograph, wide: float = 2.2) -> None:
    """Show the object and its surroundings only, in the shape of the whole picture."""
    middle = cameras.project(photo.K, (photo.R @ photo.centre + photo.t)[None])[0]
    half = wide / 2 * photo.K[0, 0] * photo.diameter / photo.t[2]
    height, width = photo.rgb.shape[:2]
    axes.set(
        xlim=(middle[0] - half, middle[0] + half),
        ylim=(middle[1] + half * height / width, middle[1] - half * height / width),
    )
