"""The figures of chapter 5 on a full turn, and the numbers that jump on the way."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from posecore import rotations
from posecore.figures import Picture
from posecore.figures.style import COLOURS, INK, STYLES, new_picture

__all__ = ["NUMBERS", "once_round", "question", "two_turns"]

# Seen from the side and a little from above: right, up, towards the reader.
VIEW = rotations.euler_to_matrix(np.radians([0, 25, 0]), "YXZ") @ [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
NOSE, TAIL, LEFT, RIGHT, KEEL = np.array(
    [[1.2, 0, 0], [-0.8, 0, 0], [-0.8, 0.85, 0.15], [-0.8, -0.85, 0.15], [-0.8, 0, -0.4]]
)
FACES = ((NOSE, TAIL, LEFT, 0.55), (NOSE, TAIL, RIGHT, 0.0), (NOSE, TAIL, KEEL, 0.25))
AXES = {"upright": [0, 0, 1.0], "slanted": [0.35, -0.5, 0.8]}
START = rotations.euler_to_matrix(np.radians([10.0, 20, -15]), "ZYX")
PLAIN = str.maketrans("", "", "\\{}")  # what alternative text does without
# name of the numbers -> how, their symbols, the least step that is a jump, what the axis says
NUMBERS = {
    "Euler angles": (
        lambda R: np.degrees(rotations.matrix_to_euler(R)),
        ("yaw", "pitch", "roll"),
        90,
        "degrees",
    ),
    "axis-angle vector": (
        lambda R: np.degrees(rotations.matrix_to_axis_angle(R)),
        (r"$\omega_x$", r"$\omega_y$", r"$\omega_z$"),
        90,
        "degrees",
    ),
    "quaternion": (rotations.matrix_to_quaternion, ("w", "x", "y", "z"), 0.5, "number"),
    "six numbers": (
        rotations.matrix_to_rotation_6d,
        tuple(f"$R_{{{row}{column}}}$" for column in (1, 2) for row in (1, 2, 3)),
        0.5,
        "number",
    ),
    "nine numbers": (
        lambda R: R.reshape(*R.shape[:-2], 9),
        tuple(f"$R_{{{row}{column}}}$" for row in (1, 2, 3) for column in (1, 2, 3)),
        0.5,
        "number",
    ),
}


def question() -> Picture:
    """One full turn of a paper plane, and two ways to say it in numbers."""
    figure = new_picture(
        9.0,
        5.2,
        "Nine paper planes in a row, each turned 45 degrees further than the last, so that the "
        "ninth stands as the first. Below, the numbers along the same full turn: those of the "
        "axis-angle vector and of the quaternion change smoothly and then jump to their "
        "opposites; those of the rotation matrix run on without a jump and end where they began.",
    )
    rows = figure.subplots(4, 1, height_ratios=[1.2, 1, 1, 1], sharex=True)
    rows[0].set(aspect="equal", ylim=(-24, 24), title="a full turn, in eight equal steps")
    rows[0].axis("off")
    for degrees in np.arange(0, 361, 45):
        _plane(rows[0], _turned(degrees, "slanted"), (degrees, 0), 20)
    for axes, name in zip(
        rows[1:], ("axis-angle vector", "quaternion", "nine numbers"), strict=True
    ):
        _curves(axes, name, "slanted", legend=False)
        axes.set_title(name, fontsize=10, loc="left", pad=3)
    rows[3].set(xlim=(-25, 385), xticks=np.arange(0, 361, 45), xlabel="turned by, degrees")
    return figure


def once_round(turn: int = 150, numbers: str = "quaternion", axis: str = "slanted") -> Picture:
    """A paper plane on its way round, and the numbers that say how it is turned.

    Args:
        turn: degrees.
        numbers: a name in `NUMBERS`.
        axis: "upright" or "slanted".
    """
    encode, symbols, _, unit = NUMBERS[numbers]
    values = encode(_turned(turn, axis))
    form = ".0f" if unit == "degrees" else ".2f"
    said = ", ".join(
        f"{symbol.strip('$').translate(PLAIN)} {value:{form}}"
        for symbol, value in zip(symbols, values, strict=True)
    )
    jumps = _jumps(numbers, axis)
    where = " and ".join(f"{place:g}°" for place in jumps)
    title = f"{numbers}: " + (f"a jump at {where}" if jumps else "no jump")
    figure = new_picture(
        9.0,
        3.4,
        f"Left: a paper plane, turned by {turn} degrees about an axis that is {axis}. Right: its "
        f"{numbers} along the full turn, {title.split(': ')[1]}; a vertical line stands at {turn} "
        f"degrees, where they are {said}.",
    )
    left, right = figure.subplots(1, 2, width_ratios=[1, 2.4])
    left.set(aspect="equal", xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), title=f"turned by {turn}°")
    left.axis("off")
    direction = (VIEW @ AXES[axis])[:2] / np.linalg.norm(AXES[axis])
    left.plot(*np.outer(direction, [-1.4, 1.4]), color="0.5", lw=1, ls="-.")
    _plane(left, _turned(turn, axis), (0, 0), 1)
    _curves(right, numbers, axis, legend=True)
    right.axvline(turn, color=INK, lw=1)
    right.plot(np.full(len(values), turn), values, "o", color=INK, ms=4)
    right.set(xlim=(0, 360), xticks=np.arange(0, 361, 45), xlabel="turned by, degrees")
    right.set_title(title, fontsize=11)
    return figure


def two_turns(turn: np.ndarray, q: np.ndarray, chosen: np.ndarray) -> Picture:
    """A quaternion (N, 4) carried along two full turns about z, and the one with w >= 0."""
    figure = new_picture(
        8.4,
        2.7,
        "The numbers w and z of a quaternion over 720 degrees of turning. Left, carried along: w "
        "is a cosine and z a sine that need both turns for one period; after one turn both have "
        "changed their sign. Right, always with w at least 0: after one turn all is as at first, "
        "but z jumps from 1 to -1 at 180 and at 540 degrees.",
    )
    titles = ("carried along: two turns for one period", "chosen, w at least 0: one turn, a jump")
    for axes, values, title in zip(figure.subplots(1, 2), (q, chosen), titles, strict=True):
        _broken(axes, np.degrees(turn), values[:, [0, 3]], ("w", "z"), 0.5)
        axes.axvline(360, color=INK, lw=1, ls=":")
        axes.set(xlabel="turned by, degrees", ylabel="number", xticks=np.arange(0, 721, 180))
        axes.set_title(title, fontsize=11)
        axes.legend(fontsize=9, loc="lower left")
    return figure


def _turned(degrees: float | np.ndarray, axis: str) -> np.ndarray:
    unit = np.array(AXES[axis]) / np.linalg.norm(AXES[axis])
    return rotations.axis_angle_to_matrix(np.radians(degrees)[..., None] * unit) @ START


def _samples(numbers: str, axis: str) -> tuple[np.ndarray, np.ndarray]:
    degrees = np.arange(721) / 2
    return degrees, NUMBERS[numbers][0](_turned(degrees, axis))


def _jumps(numbers: str, axis: str) -> list[float]:
    degrees, values = _samples(numbers, axis)
    large = np.abs(np.diff(values, axis=0)).max(1) > NUMBERS[numbers][2]
    return [round(float(place)) for place in degrees[1:][large]]


def _curves(axes: Axes, numbers: str, axis: str, legend: bool) -> None:
    degrees, values = _samples(numbers, axis)
    _, symbols, jump, unit = NUMBERS[numbers]
    _broken(axes, degrees, values, symbols, jump)
    axes.set_ylabel(unit)
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)


def _broken(axes: Axes, x: np.ndarray, values: np.ndarray, symbols: tuple, jump: float) -> None:
    """Lines that end where a value jumps, with a dotted one across."""
    at = np.flatnonzero(np.abs(np.diff(values, axis=0)).max(1) > jump)
    looks = zip(symbols, values.T, (COLOURS * 2), (STYLES * 3), strict=False)
    for symbol, curve, colour, style in looks:
        torn = np.insert(curve.astype(float), at + 1, np.nan)
        axes.plot(np.insert(x, at + 1, np.nan), torn, color=colour, ls=style, label=symbol)
        for k in at:
            axes.plot(x[[k, k]], curve[[k, k + 1]], color=colour, ls=":", lw=1.2)
            axes.plot(x[[k, k]], curve[[k, k + 1]], "o", color=colour, ms=3)


def _plane(axes: Axes, R: np.ndarray, place: tuple, size: float) -> None:
    """A paper plane, its left wing darker, far faces first."""
    faces = [(VIEW @ R @ np.array(face[:3]).T, face[3]) for face in FACES]
    for corners, shade in sorted(faces, key=lambda face: face[0][2].mean()):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        light = abs(normal @ [0.3, 0.8, 0.5]) / np.linalg.norm(normal)
        grey = str(np.clip((0.55 + 0.45 * light) * (1 - shade), 0, 1))
        axes.add_patch(Polygon(size * corners[:2].T + place, fc=grey, ec=INK, lw=0.8))
