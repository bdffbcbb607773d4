"""The figures of chapter 2 on light and on cameras: infrared, structured light, colour."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch, Polygon, Rectangle

from data_tools.renderer import Light, PreparedMesh, prepare, render_colour, render_infrared
from data_tools.sensors import linear_to_srgb
from data_tools.shapes import Material, Mesh, make_floor, make_object
from data_tools.worlds.placing import look_at, turn_z
from posecore import poses
from posecore.figures import Picture, chart, picture_grid
from posecore.figures.photographs import bare, without_grain
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "brightness",
    "depth_and_holes",
    "depth_scene",
    "exposures",
    "in_both_lights",
    "noise_of_depth",
    "photographed",
    "same_things",
    "two_distances",
    "wall",
    "why_shadows",
]

MEASURED = "#ffffff"
REASONS = ("#000000", "#0072B2", "#D55E00", "#F0B85B")  # from dark to bright, for a grey print

Pose = tuple[np.ndarray, np.ndarray]


def wall(infrared: float, lean: float) -> PreparedMesh:
    """A matt wall of one material, 4 m wide, around the origin, that leans to a side (radians)."""
    R = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    square = make_floor(0, 4.0)
    facing = np.diag([1.0, -1, -1])  # to the camera
    vertices = square.vertices @ (R @ facing).T
    normals = (square.corner_normals @ (R @ facing).T).astype(np.float32)
    material = Material((0.5, 0.5, 0.5), infrared=infrared)
    return prepare(
        replace(square, vertices=vertices, corner_normals=normals, materials=(material,))
    )


def two_distances(images: Mapping[float, np.ndarray]) -> Picture:
    """Infrared pictures of the same scene, linear, by the distance in metres."""
    titles = [f"{z:.1f} m" for z in images]
    alt = (
        "The same head with glasses in infrared, equally large. At "
        f"{titles[0]} it is bright, at {titles[-1]} very dark; the background is black in both."
    )
    shown = [np.uint8(255 * np.clip(image, 0, 1)) for image in images.values()]
    shown = [without_grain(image) for image in shown]
    return picture_grid(shown, titles, width=2.6 * len(shown), alt=alt)


def brightness(z: np.ndarray, measured: np.ndarray, slope: float) -> Picture:
    """Brightness of the forehead over its distance, on log axes, with a line for 1 / z^2."""
    fine = np.geomspace(z[0], z[-1], 50)
    middle = np.exp(np.log(measured * z**2).mean())
    return chart(
        {"falls with the square": (fine, middle / fine**2)},
        marks={f"rendered forehead, slope {slope:.2f}": (z, measured)},
        looks={"falls with the square": {"color": INK, "lw": 1.5}},
        log="xy",
        xlabel="distance of the forehead, m",
        ylabel="brightness",
        xticks=[t for t in (0.4, 0.6, 0.8, 1.2, 1.6) if z[0] <= t <= z[-1]],
        size=(5.6, 3.0),
        alt=f"On log axes the brightness of the forehead falls along a straight line from "
        f"{z[0]:.1f} to {z[-1]:.1f} m; the slope is {slope:.2f}. The line of the formula passes "
        "through.",
    )


def in_both_lights(meshes: Sequence[Mesh], R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Meshes of one frame in colour (H, W, 3) and in infrared (H, W), 0 to 1."""
    things = [prepare(mesh) for mesh in meshes]
    size, K = (170, 200), np.array([[690.0, 0, 84.5], [0, 690, 109.5], [0, 0, 1]])
    seen = [(R, np.array([0, 0.01, 0.8]))] * len(things)
    lights = [Light((-0.6, -0.6, 0.0), 0.7, 0.05), Light((0.7, -0.2, 0.1), 0.2, shadows=False)]
    colour = render_colour(things, seen, K, size, lights, background=0.42)
    lamp = Light((0.04, 0.0, 0.0), 0.8, radius=0.0)
    grey = render_infrared(things, seen, K, size, [lamp], ambient=0.01)
    return linear_to_srgb(colour), np.clip(grey, 0, 1)


def same_things(pairs: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Picture:
    """Pictures in colour and, below each, the same in infrared, by what they show."""
    colour = [np.uint8(255 * srgb) for srgb, _ in pairs.values()]
    infrared = [np.uint8(255 * grey) for _, grey in pairs.values()]
    alt = (
        "Above, in colour; below, the same in infrared: "
        + "; ".join(pairs)
        + ". Skins differ in colour and are alike in infrared, where dark lenses are black but for "
        "the lamp's glare, and prints may be gone."
    )
    titles = [f"{name}\ncolour" for name in pairs] + ["infrared"] * len(pairs)
    shown = [without_grain(image) for image in colour + infrared]
    return picture_grid(shown, titles, columns=len(pairs), width=5.8, alt=alt)


def why_shadows(f: float, baseline: float) -> Picture:
    """Camera and projector from above, with a box before a wall and what neither can measure.

    Args:
        f: focal length, pixels.
        baseline: from camera to projector, metres.
    """
    figure = new_picture(
        5.4,
        3.8,
        "From above: a camera and, to its right, a projector look at a wall; a box stands between. "
        "Left of the box a strip of the wall is seen by the camera and not lit by the projector.",
    )
    axes = figure.subplots()
    near, far, left, right = 0.3, 0.6, -0.05, 0.12
    axes.plot([-0.32, 0.32], [far, far], color=INK, lw=3)
    axes.text(0.31, far + 0.01, "wall", va="bottom", ha="right")
    axes.add_patch(Rectangle((left, near), right - left, 0.05, fc="0.75", ec=INK))
    axes.text((left + right) / 2, near + 0.025, "box", ha="center", va="center")
    # Where the ray of the projector, and that of the camera, past the box's left edge meet walls.
    lit = baseline + (left - baseline) * far / near
    hidden = left * far / near
    axes.add_patch(
        Polygon([(left, near), (hidden, far), (lit, far)], fc="#F0E442", ec="none", alpha=0.8)
    )
    axes.plot([lit, hidden], [far, far], color=COLOURS[1], lw=6, solid_capstyle="butt")
    axes.annotate(
        "seen, not lit:\nno depth here",
        ((lit + hidden) / 2, far - 0.01),
        xytext=(-0.32, 0.3),
        arrowprops={"arrowstyle": "->"},
        va="center",
    )
    axes.plot([0, hidden], [0, far], color=COLOURS[0], lw=1.5)
    axes.plot([baseline, lit], [0, far], color=COLOURS[1], lw=1.5, ls="--")
    axes.plot(0, 0, "o", color=COLOURS[0], ms=11)
    axes.plot(baseline, 0, "s", color=COLOURS[1], ms=11)
    axes.text(-0.025, 0, "camera", ha="right", va="center", color=COLOURS[0])
    axes.text(baseline + 0.025, 0, "projector", ha="left", va="center", color=COLOURS[1])
    axes.annotate("", (0, 0.05), (baseline, 0.05), arrowprops={"arrowstyle": "<->"})
    axes.text(baseline / 2, 0.075, "b", ha="center", path_effects=HALO)
    axes.set(xlim=(-0.34, 0.34), ylim=(-0.04, 0.66), aspect="equal")
    axes.set(xlabel="to the right, m", ylabel="depth z, m")
    text = f"d = f b / z\nbox {f * baseline / near:.0f} px\nwall {f * baseline / far:.0f} px"
    axes.text(0.12, 0.18, text, va="center", fontsize=10)
    return figure


def depth_scene(
    size: tuple[int, int] = (240, 180),
) -> tuple[list[PreparedMesh], list[Pose], np.ndarray]:
    """Things that a depth camera has trouble with: prepared meshes, poses, camera matrix."""
    camera = look_at(np.array([0.1, -0.66, 0.24]), np.array([0.01, -0.02, 0.085]), 0.0)
    stand = {5: (-0.17, 0.07, 20), 6: (0.08, -0.1, 60), 7: (-0.06, -0.07, 200), 8: (0.19, 0.08, 30)}
    things, placed = [], []
    for object_id, (x, y, degrees) in stand.items():
        mesh = make_object(object_id)
        things.append(prepare(mesh))
        placed.append((turn_z(np.radians(degrees)), np.array([x, y, mesh.size[2] / 2])))
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    things += [prepare(make_floor(1, 8.0)), prepare(make_floor(5, 8.0))]
    placed += [(np.eye(3), np.zeros(3)), (upright, np.array([0, 1.9, 0]))]
    seen = [poses.compose(*camera, *pose) for pose in placed]
    f = 1.25 * size[0]
    K = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
    return things, seen, K


def photographed(things: list[PreparedMesh], seen: list[Pose], K: np.ndarray) -> np.ndarray:
    """The scene for depth in colour, linear (180, 240, 3), by the light of a lamp."""
    lights = [Light((0.5, -0.7, 0.1), 0.7, 0.05)]
    casters = range(len(things) - 2)
    return render_colour(things, seen, K, (240, 180), lights, casters=casters)


def noise_of_depth(z: np.ndarray, measured: np.ndarray, plain: np.ndarray, f: float) -> Picture:
    """Standard deviation of the measured depth over the distance, and the formula's curve.

    Args:
        z: (N,) metres.
        measured, plain: (N,) standard deviations of the library's and of the page's camera, metres.
        f: standard deviation of z over z^2 by the formula, 1/m.
    """
    fine = np.linspace(0, z[-1], 60)
    return chart(
        {"formula": (fine, 1000 * f * fine**2)},
        marks={"library's camera": (z, 1000 * measured), "this page's": (z, 1000 * plain)},
        looks={
            "formula": {"color": INK, "lw": 1.5},
            "library's camera": {"color": COLOURS[0], "ms": 8, "mfc": "none"},
            "this page's": {"color": COLOURS[1], "marker": "x"},
        },
        xlabel="depth z, m",
        ylabel="standard deviation of z, mm",
        xlim=(0, None),
        ylim=(0, None),
        size=(5.6, 3.0),
        alt="The noise of depth grows with the square of the distance, from "
        f"{1000 * measured[0]:.1f} mm at {z[0]:.1f} m to {1000 * measured[-1]:.0f} mm at "
        f"{z[-1]:.1f} m. The marks of the library's camera and of the page's lie on the curve of "
        "the formula.",
    )


def depth_and_holes(
    exact: np.ndarray, measured: np.ndarray, reasons: np.ndarray, names: Sequence[str]
) -> Picture:
    """Exact and measured depth, and why there are holes.

    Args:
        exact, measured: (H, W) metres, 0 for none.
        reasons: (H, W) integers: -1 where depth was measured, otherwise which of the names.
        names: up to four.
    """
    shares = ", ".join(
        f"{name} {100 * (reasons == n).mean():.1f} %" for n, name in enumerate(names)
    )
    figure = new_picture(
        9.0,
        3.1,
        "Left, the exact depth of a table with things: smooth. Middle, what the camera measures: "
        "it has holes, most of them in strips left of the things. Right, why: "
        f"{shares} of all pixels.",
    )
    panels = figure.subplots(1, 3)
    limits = {"vmin": exact[exact > 0].min(), "vmax": np.percentile(exact[exact > 0], 80)}
    for axes, depth, title in ((panels[0], exact, "exact"), (panels[1], measured, "measured")):
        steps = np.round(np.where(depth > 0, depth, np.nan) * 100) / 100  # keeps the file small
        shown = axes.imshow(steps, cmap="viridis", interpolation="nearest", **limits)
        axes.set_title(title, fontsize=10)
        axes.set_facecolor("white")
        bare(axes, INK)
    figure.colorbar(shown, ax=panels[:2], label="depth, m", shrink=0.62, pad=0.01, location="left")
    colours = ListedColormap([MEASURED, *REASONS[: len(names)]])
    norm = BoundaryNorm(np.arange(-1.5, len(names) + 0.5), colours.N)
    panels[2].imshow(reasons, cmap=colours, norm=norm, interpolation="nearest")
    panels[2].set_title("why there is none", fontsize=10)
    bare(panels[2], INK)
    patches = [
        Patch(fc=colour, ec=INK, lw=0.6, label=name)
        for colour, name in zip(REASONS, names, strict=False)
    ]
    figure.legend(handles=patches, loc="outside lower right", ncols=4, frameon=False, fontsize=9)
    return figure


def exposures(images: Mapping[float, np.ndarray]) -> Picture:
    """The same colour picture at several exposures."""
    alt = (
        f"The same things in colour at exposures {', '.join(f'{e:g}' for e in images)}: the first "
        "is dark and grainy, in the last the bright parts have lost their pattern and are white."
    )
    titles = [f"exposure {exposure:g}" for exposure in images]
    shown = [image[40:150, 50:200] for image in images.values()]
    return picture_grid(shown, titles, width=6.0, alt=alt)
