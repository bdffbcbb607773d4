"""The figures of chapter 1 up to the metrics, which have a module of their own.

True poses are drawn in blue, estimates in orange.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from book.ch01_poses_and_cameras.drawing import clouds, photographs
from posecore import cameras, metrics, poses, registration
from posecore.figures import Picture, Viewer, draw_axes, draw_box, draw_keypoints, picture_grid
from posecore.figures.style import INK, new_picture

__all__ = [
    "before_and_after",
    "depth_picture",
    "dragged_keypoint",
    "fitting_steps",
    "frames",
    "icp_starts",
    "model_on_photograph",
    "order_matters",
    "photograph",
    "pinhole",
    "pixel_grid",
    "question",
    "real_results",
    "scan",
    "wrong_keypoints",
]

Photograph, TRUTH, ESTIMATE = photographs.Photograph, photographs.TRUTH, photographs.ESTIMATE
pale, zoom = photographs.pale, photographs.zoom
photograph, scan, real_results = photographs.photograph, photographs.scan, photographs.real_results
depth_picture, before_and_after = clouds.depth_picture, clouds.before_and_after
icp_starts = clouds.icp_starts


def question(photo: Photograph) -> Picture:
    """The picture, and the picture with the answer drawn in."""
    alt = (
        f"Left: a {photo.name} among other things. Right: the same picture with a box drawn "
        f"around the {photo.name}, which fits it from every side, and with three arrows x, y, z "
        "that start inside it: its place and its turn."
    )
    titles = [f"where is the {photo.name}, how is it turned?", "the answer: its pose"]
    figure = picture_grid([photo.rgb, photo.rgb], titles, alt=alt)
    _draw_pose(figure.axes[1], photo, photo.R, photo.t, TRUTH, with_axes=True)
    return figure


def frames(photo: Photograph) -> Viewer:
    """The object's frame and the camera's, in three dimensions."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array(photo.rgb.shape[1::-1]) - 1)
    far = 0.25 * photo.t[2]
    rays = np.linalg.solve(photo.K, np.vstack([corners.T, np.ones(4)])).T * far
    edges = [[np.zeros(3), ray] for ray in rays]
    edges += [[a, b] for a, b in zip(rays, np.roll(rays, -1, 0), strict=True)]
    alt = (
        "Two frames in space: a camera, drawn as a pyramid with its tip at the origin, and the "
        f"{photo.name} some way in front of it. Each carries three axes: z of the camera points "
        f"at the {photo.name}, its x to the right, its y down."
    )
    cloud = f"{photo.name}, in the camera's frame"
    colours = None
    if photo.normals is not None:  # light from above, so that its shape is seen
        light = 0.6 + 0.4 * photo.normals @ np.array([0.3, -0.6, 0.74])
        paint = to_rgb("#7fb8e6") if photo.colours is None else photo.colours
        colours = {cloud: light[:, None] * paint}
    return Viewer(
        {cloud: poses.apply(photo.R, photo.t, photo.points)},
        colours=colours,
        lines={"camera": np.array(edges)},
        axes=(np.stack([np.eye(3), photo.R]), np.stack([np.zeros(3), photo.t])),
        axis_length=0.8 * photo.diameter,
        up="-y",
        alt=alt,
    )


def order_matters(
    photo: Photograph, turned: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> Picture:
    """The object's pose before and after a turn, one panel for each order."""
    alt = "; ".join(turned) + ": the true pose in blue, the turned one in orange. The first box "
    alt += "turns on the spot, the second swings away to another place in the picture."
    figure = picture_grid([pale(photo)] * len(turned), list(turned), alt=alt)
    for axes, (R, t) in zip(figure.axes, turned.values(), strict=True):
        _draw_pose(axes, photo, photo.R, photo.t, TRUTH)
        _draw_pose(axes, photo, R, t, ESTIMATE, with_axes=True)
    return figure


def pinhole(photo: Photograph) -> Picture:
    """Similar triangles: a camera and one keypoint from above, to scale but for the image."""
    X, _, Z = photo.R @ photo.keypoints[0] + photo.t
    X = X if abs(X) > 0.08 * Z else np.sign(X or 1) * 0.3 * Z  # so that the triangle has a width
    figure = new_picture(
        6.4,
        2.9,
        "Seen from above: a ray from the camera's centre to a point at depth Z, X beside the "
        "optical axis. The ray crosses the image, which stands f in front of the centre, at "
        "f X / Z beside the axis: two triangles of the same shape.",
    )
    axes = figure.subplots()
    f, side, step = 0.4 * Z, np.sign(X), 0.13 * X  # `step` leads away from the ray
    axes.annotate("", (1.12 * Z, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": INK})
    axes.plot([0, Z], [0, X], color=TRUTH, lw=2)
    axes.plot([Z, Z], [0, X], color=INK, ls=":", lw=1.2)
    axes.plot([f, f], [-0.1 * X, 1.2 * X], color="0.5", lw=3)
    axes.plot([f, f], [0, f * X / Z], color=ESTIMATE, lw=4)
    axes.plot([0, Z, f], [0, X, f * X / Z], "o", color=INK, ms=5)
    for number, (length, name) in enumerate(((f, "$f$"), (Z, "$Z$")), start=1):
        ends = (0, -number * 1.6 * step), (length, -number * 1.6 * step)
        axes.annotate("", *ends, arrowprops={"arrowstyle": "<->", "color": "0.4"})
        look = {"ha": "center", "va": "center", "fontsize": 13, "backgroundcolor": "white"}
        axes.text(length / 2, ends[0][1], name, **look)
    axes.text(-0.02 * Z, 0, "camera's\ncentre", ha="right", va="center")
    axes.text(1.13 * Z, 0, "optical axis, z", va="center")
    axes.text(f, 1.24 * X, "image", ha="center", va="top" if side > 0 else "bottom", color="0.4")
    axes.text(Z * 1.02, X / 2, "$X$", va="center", fontsize=13)
    axes.text(Z * 1.02, X, "the point", va="center")
    axes.text(f * 1.03, f * X / Z / 2, r"$f\,X/Z$", va="center", fontsize=13, color=ESTIMATE)
    # As seen from above, the camera's x points down where its z points right.
    ends = sorted((-0.6 * X, 1.45 * X), reverse=True)
    axes.set(xlim=(-0.22 * Z, 1.4 * Z), ylim=ends)
    axes.set_axis_off()
    return figure


def pixel_grid() -> Picture:
    """A picture of 4 x 3 pixels with the coordinates of its centres and of its border."""
    figure = new_picture(
        4.2,
        2.8,
        "Four by three squares. The centre of the first, at the top left, is (0, 0); the "
        "picture's corner is half a pixel further out, at (-0.5, -0.5); x runs to the right, y "
        "down; the last centre is (3, 2).",
    )
    axes = figure.subplots()
    for x in range(4):
        for y in range(3):
            shade = "#cfe3f2" if (x + y) % 2 == 0 else "white"
            axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fc=shade, ec="0.4"))
            axes.plot(x, y, ".", color=INK)
            axes.text(x, y + 0.12, f"({x}, {y})", ha="center", va="top", fontsize=9)
    axes.plot(-0.5, -0.5, "s", color=ESTIMATE)
    axes.annotate("(-0.5, -0.5)", (-0.5, -0.5), xytext=(4, 7), textcoords="offset points")
    axes.set(xlim=(-0.8, 3.8), ylim=(2.7, -0.95), aspect="equal", xlabel="x, px", ylabel="y, px")
    axes.set(xticks=range(4), yticks=range(3))
    axes.spines[:].set_visible(False)
    return figure


def model_on_photograph(photo: Photograph, pixels: np.ndarray, keypoints: np.ndarray) -> Picture:
    """Projected points of the model, and the numbered keypoints, on the photograph."""
    alt = (
        f"The {photo.name} zoomed in. Left: {len(pixels)} points of its model, projected, lie on "
        f"it and nowhere else. Right: {len(keypoints)} numbered keypoints are spread over it."
    )
    figure = picture_grid([photo.rgb, pale(photo)], ["model points", "keypoints"], alt=alt)
    for axes in figure.axes:
        zoom(axes, photo)
    figure.axes[0].scatter(*pixels.T, s=2.5 if len(pixels) > 100 else 30, color=TRUTH, linewidths=0)
    draw_keypoints(figure.axes[1], keypoints, numbers=True)
    return figure


def fitting_steps(
    photo: Photograph, steps: Sequence[tuple[np.ndarray, np.ndarray]], errors: Sequence[float]
) -> Picture:
    """The first three poses of an iteration and the last, with their errors in pixels."""
    shown = [0, 1, 2, len(steps) - 1]
    titles = [f"step {i}: {errors[i]:.3g} px" for i in shown]
    alt = "A box around the object, four times. " + "; ".join(titles)
    alt += ". The orange box of the estimate starts tilted and far off the blue one of the truth "
    alt += "and ends exactly on it."
    figure = picture_grid([pale(photo)] * 4, titles, alt=alt)
    for axes, i in zip(figure.axes, shown, strict=True):
        _draw_pose(axes, photo, photo.R, photo.t, TRUTH)
        _draw_pose(axes, photo, *steps[i], ESTIMATE)
        zoom(axes, photo, 2.6)
    return figure


def wrong_keypoints(
    photo: Photograph, given: Mapping[int, np.ndarray], found: Mapping[tuple[str, int], Any]
) -> Picture:
    """Least squares and RANSAC, row by row, with more and more wrong keypoints.

    Args:
        photo: the photograph.
        given: number of wrong keypoints -> their pixels (8, 2), the wrong ones first.
        found: (method, number of wrong keypoints) -> the `PnpResult`.
    """
    methods = list(dict.fromkeys(method for method, _ in found))
    cases = [(method, wrong) for method in methods for wrong in given]
    titles = []
    for case in cases:
        off = np.degrees(metrics.rotation_error(found[case].R, photo.R))
        titles.append(f"{case[0]}, {case[1]} wrong: {off:.1f}°")
    alt = "Blue: the true box. Orange: the estimate. Crosses: wrong keypoints. "
    alt += "; ".join(titles) + ". Least squares leans towards the crosses, RANSAC ignores them."
    figure = picture_grid([pale(photo)] * len(cases), titles, columns=len(given), alt=alt)
    for axes, case in zip(figure.axes, cases, strict=True):
        _draw_pose(axes, photo, photo.R, photo.t, TRUTH)
        _draw_pose(axes, photo, found[case].R, found[case].t, ESTIMATE)
        wrong, pixels = case[1], given[case[1]]
        draw_keypoints(axes, pixels[wrong:])
        draw_keypoints(axes, pixels[:wrong], marker="x", colour=INK)
        zoom(axes, photo, 2.6)
    return figure


def dragged_keypoint(
    photo: Photograph, right: float = 30.0, down: float = 0.0, keypoint: int = 0
) -> Picture:
    """The pose that least squares finds when one keypoint is dragged away, and RANSAC's.

    Args:
        photo: the photograph.
        right, down: how far the keypoint is dragged, pixels.
        keypoint: which of the eight.
    """
    X = photo.keypoints[:8]
    pixels = cameras.project(photo.K, poses.apply(photo.R, photo.t, X))
    pixels[keypoint] += right, down
    titles, found = [], []
    for name, method in (("least squares", "iterative"), ("RANSAC", "ransac")):
        found.append(registration.pnp(X, pixels, photo.K, method))
        off = np.degrees(metrics.rotation_error(found[-1].R, photo.R))
        away = 1000 * metrics.translation_error(found[-1].t, photo.t)
        titles.append(f"{name}: {off:.1f}°, {away:.1f} mm")
    alt = f"Keypoint {keypoint} is dragged {right:g} px to the right and {down:g} px down. "
    alt += "Errors of the orange box of the estimate: " + "; ".join(titles)
    figure = picture_grid([pale(photo)] * 2, titles, alt=alt)
    figure.suptitle(
        f"keypoint {keypoint}: {right:g} px to the right, {down:g} px down", fontsize=11
    )
    for axes, result in zip(figure.axes, found, strict=True):
        _draw_pose(axes, photo, photo.R, photo.t, TRUTH)
        _draw_pose(axes, photo, result.R, result.t, ESTIMATE)
        draw_keypoints(axes, np.delete(pixels, keypoint, 0))
        draw_keypoints(axes, pixels[[keypoint]], marker="x", colour=INK)
        zoom(axes, photo, 2.6)
    return figure


def _draw_pose(
    axes: Axes,
    photo: Photograph,
    R: np.ndarray,
    t: np.ndarray,
    colour: str,
    with_axes: bool = False,
) -> None:
    draw_box(axes, photo.K, R, t, photo.size, centre=photo.centre, colour=colour)
    if with_axes:
        draw_axes(axes, photo.K, R, t, 0.75 * photo.diameter)
