"""The figures of chapter 2's tour: what is in the three worlds."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import to_rgb

from book.ch01_poses_and_cameras.drawing.stand_in import sample_surface
from data_tools.renderer import Light, PreparedMesh, prepare, render_colour
from data_tools.sensors import linear_to_srgb
from data_tools.shapes import GLASSES, NAMES, make_glasses, make_object, make_subject
from data_tools.views import View
from data_tools.worlds.placing import look_at
from posecore import poses
from posecore.figures import (
    Picture,
    Viewer,
    draw_axes,
    draw_box,
    draw_outline,
    picture_grid,
)
from posecore.figures.photographs import thin_lines, without_grain
from posecore.figures.style import BOX_COLOURS, COLOURS
from posecore.rotations import euler_to_matrix

__all__ = [
    "eight_objects",
    "faces",
    "four_glasses",
    "head_turns",
    "in_the_car",
    "outside_the_image",
    "tables",
    "three_cameras",
]

Pose = tuple[np.ndarray, np.ndarray]
CAMERA_GREYS = ("#000000", "#666666", "#a0a0a0")
PAPER = 0.92  # linear; behind objects that are shown alone


def three_cameras(views: Sequence[View], names: Sequence[str]) -> Picture:
    """One instant of the headset world in three cameras, with the pose of the glasses."""
    figure = picture_grid(
        [_bright(view.ir) for view in views],
        list(names),
        width=9.0,
        alt="The same driver with AR glasses at the same instant, in infrared: seen by the left, "
        "the centre and the right camera. On each picture the axes of the glasses' frame are drawn "
        "from between the lenses: the same three axes from three sides.",
    )
    for axes, view in zip(figure.axes, views, strict=True):
        draw_axes(axes, view.K, view.objects[0].R, view.objects[0].t, 0.09)
    return figure


def four_glasses() -> Picture:
    """The four glasses alone, in colour."""
    size, K = (230, 130), np.array([[900.0, 0, 108], [0, 900, 62], [0, 0, 1]])
    pose = euler_to_matrix(np.radians([-32.0, 14.0, 0.0]), "YXZ"), np.array([0, 0, 0.8])
    images = [_alone(prepare(make_glasses(name)), pose, K, size) for name in GLASSES]
    alt = (
        "The four AR glasses, drawn alone: classic with a thick dark frame, round with thin golden "
        "rims and a camera at one hinge, a visor of one dark shield, and prism, a thin bar with a "
        "display before one eye."
    )
    return picture_grid(
        [without_grain(i) for i in images],
        [f"{n}: {name}" for n, name in enumerate(GLASSES, 1)],
        alt=alt,
    )


def faces(views: Sequence[View], columns: int = 4) -> Picture:
    """Heads cut out of views of the headset world."""
    images = [_head_of(view) for view in views]
    titles = [f"{v.scene_id}: {GLASSES[v.objects[0].object_id - 1]}" for v in views]
    alt = (
        "Heads in infrared as the centre camera sees them, subject and glasses: "
        + "; ".join(titles)
        + "."
    )
    return picture_grid(images, titles, columns=columns, width=7.2, alt=alt)


def in_the_car(view: View, all_cameras: Sequence[np.ndarray], names: Sequence[str]) -> Viewer:
    """Head, glasses and three cameras in the car's frame, to turn.

    Args:
        view: of the headset world; its glasses and its subject are drawn at their pose.
        all_cameras: (4, 4) poses of the cameras in the car.
        names: of the cameras.
    """
    item = view.objects[0]
    pose = poses.compose(view.T_world_cam[:3, :3], view.T_world_cam[:3, 3], item.R, item.t)
    person = make_subject(view.scene_id)
    eyewear = make_glasses(GLASSES[item.object_id - 1])
    clouds, colours = {}, {}
    for name, mesh, count in (("head", person.head, 1000), ("glasses", eyewear, 400)):
        points, normals = sample_surface(mesh.vertices, mesh.faces, count)
        clouds[name] = poses.apply(*pose, points)
        shade = 0.3 + 0.7 * np.clip(normals @ [-0.4, -0.5, -0.75], 0, 1)
        colours[name] = shade[:, None] * to_rgb(COLOURS[4] if name == "head" else COLOURS[0])
    lines = {}
    corners = np.array([[-0.42, -0.25, 1], [0.42, -0.25, 1], [0.42, 0.25, 1], [-0.42, 0.25, 1]])
    for name, T in zip(names, all_cameras, strict=True):
        apex, ends = T[:3, 3], poses.apply(T[:3, :3], T[:3, 3], 0.13 * corners)
        sides = [(apex, end) for end in ends] + list(zip(ends, np.roll(ends, -1, 0), strict=True))
        lines[f"{name} camera"] = np.array(sides)
    R = np.stack([pose[0], *(T[:3, :3] for T in all_cameras)])
    t = np.stack([pose[1], *(T[:3, 3] for T in all_cameras)])
    return Viewer(
        clouds,
        colours=colours | dict(zip(lines, CAMERA_GREYS, strict=True)),
        axes=(R, t),
        axis_length=0.1,
        lines=lines,
        up="-y",
        alt="A head with glasses and, in front of it, three cameras in a row, each with its frame: "
        "x right, y down, z forward. The glasses' frame lies between the lenses; its x axis points "
        "to the wearer's left, y down, z to the back of the head.",
    )


def head_turns(turns: Mapping[str, np.ndarray]) -> Picture:
    """A head seen from straight in front, turned, with the axes of its glasses.

    Args:
        turns: by name the rotations (3, 3).
    """
    person = make_subject(4)
    things = [prepare(mesh) for mesh in (make_glasses("classic"), person.head)]
    size, K = (170, 180), np.array([[560.0, 0, 84.5], [0, 560, 89.5], [0, 0, 1]])
    t = np.array([0, -0.005, 0.8])
    images = [_alone(things, (R, t), K, size) for R in turns.values()]
    figure = picture_grid(
        [without_grain(image) for image in images],
        list(turns),
        width=6.8,
        alt="A head with glasses from straight in front, with axes x to the right, y down and z "
        "away from us. With a positive yaw the face turns to the left of the picture, with a "
        "positive pitch it looks down, with a positive roll it tilts clockwise.",
    )
    for axes, R in zip(figure.axes, turns.values(), strict=True):
        draw_axes(axes, K, R, t, 0.085)
        thin_lines(axes, 2)
    return figure


def eight_objects(notes: Mapping[int, str]) -> Picture:
    """The objects of the tabletop world alone, with a note on each by its id."""
    camera = look_at(np.array([0.3, -0.62, 0.4]), np.zeros(3), 0.0)
    size, K = (190, 160), np.array([[520.0, 0, 94.5], [0, 520, 79.5], [0, 0, 1]])
    numbers = range(1, len(NAMES) + 1)
    images = [_alone(prepare(make_object(n)), camera, K, size) for n in numbers]
    titles = [f"{n}: {NAMES[n - 1]}\n{notes[n]}" for n in numbers]
    names = ", ".join(f"{NAMES[n - 1]} ({notes[n]})" for n in numbers)
    return picture_grid(
        [without_grain(image) for image in images],
        titles,
        columns=4,
        alt=f"Eight objects, each alone: {names}.",
    )


def tables(views: Mapping[str, View], size: Mapping[int, np.ndarray]) -> Picture:
    """Views of the tabletop world with the true boxes of their objects.

    Args:
        views: by title.
        size: (3,) of the box by object id, metres; empty for no boxes.
    """
    images = [without_grain(view.rgb) for view in views.values()]
    drawn = ", with the true box around each object" if size else ""
    alt = f"Pictures of objects{drawn}: " + "; ".join(
        f"{title} with {len(view.objects)} labelled objects" for title, view in views.items()
    )
    figure = picture_grid(images, list(views), width=7.4 if len(images) > 2 else 6.4, alt=alt)
    for axes, view in zip(figure.axes, views.values(), strict=True):
        for number, item in enumerate(view.objects if size else ()):
            colour = BOX_COLOURS[number % len(BOX_COLOURS)]
            draw_box(axes, view.K, item.R, item.t, size[item.object_id], colour=colour)
        thin_lines(axes, 1.4)
    return figure


def outside_the_image(view: View, index: int, full: np.ndarray, share: float) -> Picture:
    """An object that is partly outside, its visible pixels and its full silhouette.

    Args:
        view: with a colour image.
        index: which of its objects.
        full: (3 H, 3 W) bool, the silhouette in a larger image, the view in its middle.
        share: its visible fraction.
    """
    height, width = view.shape
    canvas = np.full((3 * height, 3 * width, 3), 235, np.uint8)
    mask = view.objects[index].mask
    pale = (0.6 * view.rgb + 0.4 * 255).astype(np.uint8)
    pale[mask] = np.minimum(view.rgb[mask], 170) * 1.5
    canvas[height : 2 * height, width : 2 * width] = without_grain(pale)
    rows, columns = np.nonzero(full)
    low = np.minimum([columns.min(), rows.min()], [width, height]) - 8
    high = np.maximum([columns.max(), rows.max()], [2 * width, 2 * height]) + 8
    name = NAMES[view.objects[index].object_id - 1]
    cut = np.s_[low[1] : high[1], low[0] : high[0]]
    inside = np.zeros(full.shape, bool)
    inside[height : 2 * height, width : 2 * width] = mask
    figure = picture_grid(
        [canvas[cut]],
        [f"visible {mask.sum()} of {full.sum()} pixels: {share:.2f}"],
        width=3.5,
        alt=f"A picture with a {name} of which a part is beyond its border. The outline of the "
        f"full silhouette goes on outside; {share:.2f} of it is seen.",
    )
    draw_outline(figure.axes[0], full[cut], colour=COLOURS[1], style="--", label="full")
    draw_outline(figure.axes[0], inside[cut], colour=COLOURS[0], label="visible")
    thin_lines(figure.axes[0], 1.8)
    figure.axes[0].legend(fontsize=9, loc="lower right")
    return figure


def _bright(infrared: np.ndarray) -> np.ndarray:
    """An infrared image half as bright again, as the eye likes it."""
    return without_grain(np.uint8(1.5 * np.minimum(infrared, 170)))


def _head_of(view: View) -> np.ndarray:
    """A square around the head, of three quarters of the image's height."""
    box = view.objects[1].box
    height, width = view.ir.shape
    side = 3 * height // 4
    low = np.round(box[:2] + box[2:] / 2 - side / 2).clip(0, [width - side, height - side])
    x, y = low.astype(int)
    return _bright(view.ir)[y : y + side, x : x + side]


def _alone(
    things: PreparedMesh | Sequence[PreparedMesh], pose: Pose, K: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Things at one pose before bright paper, bytes."""
    things = [things] if isinstance(things, PreparedMesh) else list(things)
    lights = [Light((-0.5, -0.7, 0.0), 0.75, 0.06), Light((0.7, -0.2, 0.1), 0.25, shadows=False)]
    picture = render_colour(things, [pose] * len(things), K, size, lights, background=PAPER)
    return np.uint8(np.round(255 * linear_to_srgb(picture)))
