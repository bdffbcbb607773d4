"""The figures of chapter 2 from a rasterised mesh to a picture, and the scene that they show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.patches import FancyArrowPatch

from data_tools.renderer import Light
from data_tools.sensors import linear_to_srgb
from data_tools.shapes import Material, Mesh, make_floor, make_object
from data_tools.worlds.placing import look_at, turn_z
from posecore import poses
from posecore.figures import Picture, picture_grid
from posecore.figures.style import COLOURS, HALO, INK, new_picture

__all__ = [
    "StillLife",
    "cut_or_not",
    "flat_and_smooth",
    "masks",
    "matt",
    "mesh_of",
    "of_clay",
    "spread_beam",
    "still_life",
    "tiles",
    "what_a_pixel_knows",
    "what_is_added",
]

CLAY = Material((0.5, 0.5, 0.5))


@dataclass(frozen=True, eq=False)
class StillLife:
    """Three objects on a floor, before one camera, under one lamp.

    Attributes:
        meshes: duck, can, car and the floor.
        poses: of each its (R, t) to the camera.
        K: (3, 3) camera matrix.
        close_K: (3, 3), the same camera with a longer lens, on the duck's head.
        size: (width, height) of the image, pixels.
        lamp: in the camera's frame.
        exposure: of a photograph of it.
    """

    meshes: Sequence[Mesh]
    poses: Sequence[tuple[np.ndarray, np.ndarray]]
    K: np.ndarray
    close_K: np.ndarray
    size: tuple[int, int]
    lamp: Light
    exposure: float


def still_life() -> StillLife:
    """The scene of the chapter's first half, always the same."""
    camera = look_at(np.array([0.1, -0.5, 0.34]), np.array([0.005, 0.0, 0.045]), 0.0)
    meshes, placed = [], []
    for number, x, y, angle in (
        (1, 0.0, -0.04, 0.75),
        (2, 0.115, 0.06, 0.35),
        (6, -0.1, 0.07, 0.5),
    ):
        mesh = make_object(number)
        meshes.append(mesh)
        on_floor = np.array([x, y, -mesh.vertices[:, 2].min()])
        placed.append(poses.compose(*camera, turn_z(angle), on_floor))
    R, t = camera
    return StillLife(
        meshes=(*meshes, make_floor(2, 6.0)),
        poses=(*placed, camera),
        K=np.array([[230, 0, 79.5], [0, 230, 59.5], [0, 0, 1.0]]),
        close_K=np.array([[820, 0, 58.0], [0, 820, 62], [0, 0, 1]]),
        size=(160, 120),
        lamp=Light(R @ [-0.45, -0.5, 0.8] + t, power=1.0, radius=0.03),
        exposure=1.3,
    )


def mesh_of(vertices: np.ndarray, faces: Sequence[Sequence[int]], closed: bool = False) -> Mesh:
    """Bare triangles as the library's mesh: of clay, flat, seen from both sides if not `closed`."""
    vertices, faces = np.array(vertices, np.float64), np.array(faces, np.int32)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        name="triangles",
        vertices=vertices,
        faces=faces,
        corner_normals=np.repeat(normals[:, None], 3, axis=1).astype(np.float32),
        material=np.zeros(len(faces), np.int16),
        materials=(CLAY,),
        closed=np.full(len(faces), closed),
    )


def tiles(side: float, count: int) -> Mesh:
    """A floor of `count` x `count` squares around the origin, `side` metres wide, z up."""
    edges = np.linspace(-side / 2, side / 2, count + 1)
    x, y = np.meshgrid(edges, edges)
    corner = np.arange((count + 1) ** 2).reshape(count + 1, -1)
    one, two, three, four = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    halves = [np.stack(half, -1).reshape(-1, 3) for half in ((one, two, three), (one, three, four))]
    return mesh_of(np.stack([x, y, 0 * x], -1).reshape(-1, 3), np.concatenate(halves))


def of_clay(mesh: Mesh) -> Mesh:
    """The same shape, matt and grey all over."""
    return replace(mesh, materials=(CLAY,) * len(mesh.materials))


def matt(mesh: Mesh) -> Mesh:
    """The same shape and paint, without gloss."""
    return replace(mesh, materials=tuple(replace(m, specular=0.0) for m in mesh.materials))


def what_a_pixel_knows(
    depth: np.ndarray, face: np.ndarray, coordinates: np.ndarray, mesh: Mesh
) -> Picture:
    """Depth, triangle and object coordinates of one rasterised object, near the object only."""
    seen = face >= 0
    window = _window(seen)
    near, far = depth[seen].min(), depth[seen].max()
    nearness = np.where(seen, 1 - 0.85 * (depth - near) / (far - near), np.nan)
    shuffled = np.random.default_rng(0).permutation(len(mesh.faces))
    number = np.where(seen, 0.15 + 0.8 * shuffled[face] / len(mesh.faces), np.nan)
    places = (coordinates - mesh.bounds[0]) / mesh.size
    colours = np.where(seen[..., None], np.clip(places, 0, 1), 0.93)
    titles = [f"depth: {near:.2f} m white, {far:.2f} m dark", "triangle", "place on the object"]
    return picture_grid(
        [nearness[window], number[window], colours[window]],
        titles,
        limits=(0, 1),
        columns=3,
        width=8.0,
        alt=f"Part of the {mesh.name}, three times. Left, its depth: near is light, far is dark. "
        "Middle, a random grey for each triangle: a mosaic of small triangles. Right, the "
        "place on the object in colours, which change smoothly along its x, y and z.",
    )


def masks(full: np.ndarray, visible: np.ndarray, names: Sequence[str]) -> Picture:
    """The full mask (N, H, W) of each object in grey, with the visible part in black."""
    tones = [np.where(v, 0, np.where(f, 150, 240)) for f, v in zip(full, visible, strict=True)]
    shares = visible.sum((1, 2)) / full.sum((1, 2))
    titles = [f"{name}: {100 * s:.0f} % visible" for name, s in zip(names, shares, strict=True)]
    alt = (
        "One panel per object; black is its visible mask, grey what others hide of its full mask. "
    )
    return picture_grid(
        [tone.astype(np.uint8)[_window(full.any(0))] for tone in tones],
        titles,
        columns=len(titles),
        width=8.4,
        alt=alt + "; ".join(titles),
    )


def spread_beam() -> Picture:
    """A beam of light on a surface that faces it, and on one that is tilted by 60 degrees."""
    figure = new_picture(
        8.0,
        3.0,
        "Twice a beam of six parallel rays falls from above on a surface, drawn from the side. "
        "Left, the surface is level and the lit stretch as wide as the beam. Right, it is tilted "
        "by 60 degrees, and the same six rays spread over a stretch twice as long.",
    )
    for axes, tilt in zip(figure.subplots(1, 2), (0, 60), strict=True):
        angle = np.radians(tilt)
        along = np.array([np.cos(angle), -np.sin(angle)])
        normal = np.array([np.sin(angle), np.cos(angle)])
        axes.plot(*np.outer(along, [-1.7, 1.7]), color="0.7", lw=7, solid_capstyle="butt")
        ends = 0.5 / np.cos(angle)
        axes.plot(*np.outer(along, [-ends, ends]), color=COLOURS[4], lw=7, solid_capstyle="butt")
        for x in np.linspace(-0.5, 0.5, 6):
            end = x, -x * np.tan(angle) + 0.05
            axes.add_patch(
                FancyArrowPatch((x, 2.1), end, arrowstyle="-|>", mutation_scale=9, color=COLOURS[1])
            )
        for direction, name in ((normal, "$n$"), (np.array([0, 1.0]), "$l$")):
            if name == "$n$" or tilt:
                axes.annotate("", 1.5 * direction, (0, 0), arrowprops={"arrowstyle": "->", "lw": 2})
                shift = (0.16, 0.05) if name == "$n$" else (-0.14, 0.1)
                axes.text(*(1.5 * direction + shift), name, fontsize=14, path_effects=HALO)
        if tilt:
            arc = np.linspace(0, angle, 30)
            axes.plot(0.8 * np.sin(arc), 0.8 * np.cos(arc), color=INK, lw=1.2)
            axes.text(0.66, 1.0, r"$\theta$", fontsize=14)
        stretch = 1 / np.cos(angle)
        axes.set_title(
            f"{tilt}°: light on {stretch:.0f} x the beam's width, brightness {np.cos(angle):.1f}",
            fontsize=10,
        )
        axes.set(xlim=(-2.2, 2.2), ylim=(-1.6, 2.2), aspect="equal")
        axes.set_axis_off()
    return figure


def flat_and_smooth(shaded: Mapping[str, np.ndarray], seen: np.ndarray) -> Picture:
    """Brightness (H, W) with one normal a triangle and with mixed ones, near the object only."""
    window = _window(seen)
    top = max(image.max() for image in shaded.values())
    images = [np.where(seen, image / top, np.nan)[window] for image in shaded.values()]
    return picture_grid(
        images,
        [*shaded],
        limits=(0, 1),
        width=6.4,
        alt="The same object twice, lit from the left. Flat: each triangle has one brightness and "
        "the surface looks cut. Smooth: the brightness changes evenly and the surface looks round.",
    )


def cut_or_not(wrong: np.ndarray, right: np.ndarray) -> Picture:
    """Depth (H, W) of a floor with things on it, without and with the cut at the near plane."""
    low, high = right.min(), np.percentile(right, 97)
    shown = [np.where(np.isfinite(wrong), wrong, np.nan), right]
    return picture_grid(
        [np.clip(image, low, high) for image in shown],
        ["not cut", "cut at the near plane"],
        limits=(low, high),
        colour_bar="depth, m",
        width=6.4,
        alt="The depth of three things on a floor. Not cut: a wedge of the floor is missing at the "
        "bottom of the picture, and the things hover over nothing. Cut: the floor is complete, and "
        f"its depth rises evenly from {low:.2f} m at the bottom.",
    )


def what_is_added(
    steps: Mapping[str, np.ndarray], photograph: np.ndarray, exposure: float
) -> Picture:
    """Linear pictures (H, W, 3), step by step, and the photograph that they end in."""
    images = [
        np.round(255 * linear_to_srgb(exposure * step)).astype(np.uint8) for step in steps.values()
    ]
    titles = [f"{k}. {name}" for k, name in enumerate([*steps, "camera"], start=1)]
    height = len(photograph)
    window = slice(height // 6, height - height // 10)  # where the things are
    shown = [image[window] for image in (*images, photograph)]
    return picture_grid(
        shown,
        titles,
        columns=3,
        width=8.4,
        alt="A toy duck, a tin can and a toy car on a tiled floor, six times: in grey clay; in "
        "their colours, with a label on the can; with shadows on the floor; with softer "
        "shadows and highlights; with smooth edges; with a camera's noise.",
    )


def _window(seen: np.ndarray, border: int = 3) -> tuple[slice, slice]:
    """The part of the image around what is seen."""
    y, x = np.nonzero(seen)
    return (
        slice(max(y.min() - border, 0), y.max() + border + 1),
        slice(max(x.min() - border, 0), x.max() + border + 1),
    )
