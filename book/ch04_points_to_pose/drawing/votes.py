"""Figures of chapter 4 about keypoints, the votes for them, and the two signs of a quaternion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from posecore.arrays import fail
from posecore.figures import Picture, Viewer, draw_chart
from posecore.figures.style import COLOURS, HALO, INK, house_style, new_picture, to_floats

__all__ = ["arrows", "double_cover", "keypoints", "spread", "vote_arrows"]

CENTIMETRES = 100.0
SIDES = {"from the front": 0, "from the side": 2}
"""Which coordinate runs to the right; y runs down."""

Points = np.ndarray | Tensor


@house_style
def keypoints(surfaces: Mapping[str, Points], chosen: Points) -> Picture:
    """Numbered keypoints on what they were chosen from, from the front and the side.

    Args:
        surfaces: label -> (N, 3) metres, from light to dark.
        chosen: (K, 3) metres; the last is the centre, which lies within.
    """
    chosen = to_floats("chosen", chosen, "K", 3)
    figure = new_picture(
        7.4, 4.4,
        f"{len(chosen)} keypoints, numbered from 0, on {' and '.join(surfaces)}, from the front "
        "and the side: they lie at the ends of the shape; the last, the centre of its box, inside.",
    )  # fmt: skip
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (title, across) in zip(panels, SIDES.items(), strict=True):
        for grey, (label, points) in zip(("0.82", "0.45"), surfaces.items(), strict=False):
            flat = CENTIMETRES * to_floats("surfaces", points, "N", 3)[:, [across, 1]]
            axes.scatter(*flat.T, s=2, color=grey, linewidths=0)
            axes.scatter([], [], s=30, color=grey, label=label)
        flat = CENTIMETRES * chosen[:, [across, 1]]
        axes.scatter(*flat[:-1].T, s=60, color=COLOURS[1], label="keypoint", zorder=3)
        axes.scatter(*flat[-1:].T, s=60, facecolors="white", edgecolors=COLOURS[1], linewidths=2,
                     label="centre", zorder=3)  # fmt: skip
        for number, (x, y) in enumerate(flat):
            # Seen from one side two may lie on each other: their numbers stand on both sides.
            twin = any(np.hypot(*(flat[k] - flat[number])) < 1 for k in range(number))
            text = axes.annotate(
                str(number), (x, y), (-7 if twin else 7, 5), textcoords="offset points",
                ha="right" if twin else "left", fontsize=11, fontweight="bold", zorder=4,
            )  # fmt: skip
            text.set_path_effects(HALO)
        axes.set(xlabel=f"{'xyz'[across]}, cm", title=title)
        axes.set_aspect("equal")
    axes.invert_yaxis()
    figure.axes[0].set_ylabel("y, cm")
    handles, names = axes.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    return figure


def arrows(starts: Points, tips: Points, head: float = 0.006) -> np.ndarray:
    """Arrows as segments: a shaft each, and two strokes at its tip.

    Args:
        starts, tips: (..., 3) metres, of the same shape after broadcasting.
        head: length of the strokes, metres; at most a third of the shaft.

    Returns:
        (S, 2, 3) metres; an arrow without a length has none.
    """
    starts, tips = np.broadcast_arrays(
        to_floats("starts", starts, "...", 3), to_floats("tips", tips, "...", 3)
    )
    starts, tips = starts.reshape(-1, 3), tips.reshape(-1, 3)
    along = tips - starts
    length = np.linalg.norm(along, axis=1)
    starts, tips, along, length = (values[length > 0] for values in (starts, tips, along, length))
    along = along / length[:, None]
    # Any direction across the arrow: across the axis that it is least along.
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    back = np.minimum(head, length / 3)[:, None]
    strokes = [tips - back * (along + side * 0.5 * across) for side in (-1, 1)]
    return np.concatenate([np.stack([starts, tips], 1), *(np.stack([tips, s], 1) for s in strokes)])


def vote_arrows(
    cloud: Points,
    seeds: Points,
    votes: Points,
    true: Points | None = None,
    *,
    which: Sequence[int] = (0,),
    most: int = 40,
) -> Viewer:
    """The votes of one cloud's seeds in 3D: arrows from seeds to where they think a keypoint is.

    Args:
        cloud: (N, 3) metres.
        seeds: (S, 3) metres, in the same frame.
        votes: (S, K, 3) metres, as of one cloud in `Prediction.votes`.
        true: (K, 3) metres, where the keypoints truly are.
        which: numbers of the keypoints whose votes are drawn.
        most: seeds that are drawn; the first ones, which farthest point sampling has spread.

    Raises:
        ValueError: if shapes do not fit, or a keypoint is asked for that has no votes.
    """
    seeds = to_floats("seeds", seeds, "S", 3)
    votes = to_floats("votes", votes, len(seeds), "K", 3)
    for number in which:
        if not 0 <= number < votes.shape[1]:
            fail("which", f"numbers from 0 to {votes.shape[1] - 1}", number)
    drawn = {f"votes for keypoint {k}": arrows(seeds[:most], votes[:most, k]) for k in which}
    colours = dict(zip(drawn, (COLOURS[1], COLOURS[3], COLOURS[2], INK), strict=False))
    points = {"cloud": cloud, "seeds": seeds[:most]}
    if true is not None:
        points["true keypoint"] = to_floats("true", true, votes.shape[1], 3)[list(which)]
    return Viewer(
        points, lines=drawn, up="-y", unit="cm",
        colours={"cloud": "#b0b0b0", "seeds": COLOURS[0], **colours}
        | ({"true keypoint": INK} if true is not None else {}),
        alt=f"A cloud of a head with glasses; arrows lead from {min(most, len(seeds))} seeds to "
        f"where each thinks that keypoint {', '.join(map(str, which))} is.",
    )  # fmt: skip


@house_style
def spread(votes: Points, answers: Mapping[str, Points], truth: Points) -> Picture:
    """All votes for one keypoint from the front, about the truth, and what they come to.

    Args:
        votes: (S, 3) metres.
        answers: label -> (3,) metres.
        truth: (3,) metres.
    """
    votes, truth = to_floats("votes", votes, "S", 3), to_floats("truth", truth, 3)
    off = {
        label: CENTIMETRES * (to_floats("answers", place, 3) - truth)
        for label, place in answers.items()
    }
    said = ", ".join(f"{label} {np.linalg.norm(o):.1f} cm" for label, o in off.items())
    figure = new_picture(
        5.6, 4.2,
        f"Votes for one keypoint around the truth, most near it and some far away. Off by: {said}.",
    )  # fmt: skip
    axes = figure.subplots()
    axes.axhline(0, color="0.7", lw=0.8)
    axes.axvline(0, color="0.7", lw=0.8)
    x, y = (CENTIMETRES * (votes - truth))[:, :2].T
    axes.scatter(x, y, s=18, color="0.55", linewidths=0, label=f"{len(votes)} votes")
    for number, (label, place) in enumerate(off.items()):
        look = {"color": COLOURS[(1, 0)[number % 2]], "marker": "XD"[number % 2]}
        label = f"{label}: {np.linalg.norm(place):.1f} cm off"
        axes.scatter(*place[:2], s=110, edgecolors="white", label=label, **look)
    axes.set(xlabel="x from the truth, cm", ylabel="y from the truth, cm")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.legend(fontsize=9)
    return figure


@house_style
def double_cover(
    angles: Points, losses: Mapping[str, Points], pulls: Mapping[str, Points]
) -> Picture:
    """Losses of the quaternions on a circle through q and -q, and where each loss pushes.

    Args:
        angles: (A,) radians on the circle, q at 0 and -q at pi.
        losses: label -> (A,), of a quaternion at each angle.
        pulls: label -> (A,), how fast the loss grows with the angle.
    """
    angles = to_floats("angles", angles, "A")
    figure = new_picture(
        3.1 * len(losses) + 4.2, 3.5,
        "Circles of quaternions with q at the right and -q at the left. The plain loss pushes "
        "everything to q, also from beside -q, which is the same rotation and the top of a hill; "
        "the sign-free loss pushes to the nearer of both. As curves: one valley against two.",
    )  # fmt: skip
    panels = figure.subplots(1, len(losses) + 1, width_ratios=[3] * len(losses) + [3.6])
    circle = np.linspace(0, 2 * np.pi, 200)
    few = np.arange(0, len(angles) - 1, max(1, len(angles) // 16))
    for axes, (label, pull) in zip(panels, pulls.items(), strict=False):
        # Where the loss is 0 the push is rounding.
        near = to_floats("losses", losses[label], len(angles)) < 1e-3
        pull = np.where(near, 0, to_floats("pulls", pull, len(angles)))
        axes.plot(np.cos(circle), np.sin(circle), color="0.75", lw=1)
        place = np.stack([np.cos(angles), np.sin(angles)])[:, few]
        along = np.stack([-np.sin(angles), np.cos(angles)])[:, few]
        axes.quiver(*place, *(-pull[few] * along), angles="xy", scale_units="xy", scale=2.8,
                    width=0.013, color=COLOURS[0], pivot="mid", headwidth=4.5, headlength=5,
                    headaxislength=4.5, zorder=3)  # fmt: skip
        for x, name in ((1, "$q$"), (-1, "$-q$")):
            axes.plot(x, 0, "o", color=COLOURS[1], ms=9, zorder=4)
            axes.text(0.72 * x, 0, name, ha="center", va="center", fontsize=13)
        axes.set(title=f"{label}: where it pushes", xticks=[], yticks=[])
        axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
        axes.set_aspect("equal")
        axes.spines[:].set_visible(False)
    draw_chart(
        panels[-1], losses, x=np.degrees(angles), xlabel="on the circle, degrees",
        ylabel="loss", xticks={0: "0\nq", 90: "90", 180: "180\n−q", 270: "270", 360: "360\nq"},
    )  # fmt: skip
    return figure
