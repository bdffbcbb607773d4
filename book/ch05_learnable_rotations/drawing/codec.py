"""The figures of chapter 5 on the rotation autoencoder: its layers, its code space, its size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from matplotlib.axes import Axes
from torch import Tensor

from posecore import rotations
from posecore.figures import Picture, draw_chart
from posecore.figures.style import COLOURS, INK, MARKERS, STYLES, new_picture
from posecore.nets.rotation_heads import RotationCodec

__all__ = [
    "near_and_far",
    "one_turn",
    "pipeline",
    "plane_part",
    "rays",
    "side_by_side",
    "sizes",
    "spectra",
    "training",
    "wave_distances",
]


def pipeline(codec: RotationCodec, R: Tensor) -> Picture:
    """The numbers of every layer for one rotation (3, 3), from left to right."""
    waves: list[Tensor] = []
    hidden: list[Tensor] = []
    hooks = [
        codec.project.register_forward_pre_hook(lambda _, inputs: waves.append(inputs[0])),
        codec.project.register_forward_hook(lambda _, inputs, output: hidden.append(output)),
        codec.mlp[1].register_forward_hook(lambda _, inputs, output: hidden.append(output)),
    ]
    with torch.no_grad():
        code = codec.encode(R).reshape(3, 3)
        decoded = codec(R)
    for hook in hooks:
        hook.remove()
    off = float(torch.rad2deg(rotations.geodesic_distance(decoded, R)))
    figure = new_picture(
        8.2,
        2.1,
        "The nine numbers of a rotation become a block of sines and cosines, twice 128 numbers, "
        f"nine numbers, and a rotation again, which is {off:.1f}° from the first.",
    )
    panels = figure.subplots(1, 6, width_ratios=(1, 1.15, 1.15, 1.15, 1, 1))
    blocks = [
        ("$R$\n3 x 3", R),
        (f"sines, cosines\n9 x {2 * codec.octaves}", waves[0].reshape(9, -1)),
        ("linear\n128", hidden[0].reshape(16, -1)),
        ("linear, LeakyReLU\n128", hidden[1].reshape(16, -1)),
        ("linear: $R'$\n3 x 3", code),
        (f"Procrustes\n{off:.1f}° off", decoded),
    ]
    for axes, (title, block) in zip(panels, blocks, strict=True):
        axes.set_title(title, fontsize=9)
        _heat(axes, block.numpy(), numbers=len(block) == 3)
    return figure


def side_by_side(R: Tensor, code: Tensor, size: float) -> Picture:
    """A few rotations (N, 3, 3) above their codes (N, 3, 3), which are divided by `size`."""
    figure = new_picture(
        8.2,
        3.0,
        f"{len(R)} rotation matrices as fields of numbers, light for large; below each its code, "
        "which looks much like it.",
    )
    panels = figure.subplots(2, len(R))
    for column, pair in enumerate(zip(R, code / size, strict=True)):
        for axes, block in zip(panels[:, column], pair, strict=True):
            _heat(axes, block.numpy(), numbers=True)
    panels[0, 0].set_ylabel("$R$", rotation=0, labelpad=14)
    panels[1, 0].set_ylabel(f"$R'$ / {size:.2f}", rotation=0, labelpad=22)
    return figure


def plane_part(M: Tensor, axis: int) -> Tensor:
    """(..., 3, 3) -> (..., 2): what of M turns about a coordinate axis, as (cosine, sine)."""
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    return torch.stack([M[..., i, i] + M[..., j, j], M[..., j, i] - M[..., i, j]], -1) / 2


def rays(codecs: Mapping[str, RotationCodec]) -> Picture:
    """Where codecs take full turns about x, y and z, in the plane in which the turn is an angle."""
    turn = torch.linspace(0, 2 * np.pi, 361)
    figure = new_picture(
        8.2,
        3.1,
        "Three planes. In each a circle, the turns themselves, and a closed curve for each codec, "
        "smaller or larger, that goes once round. Lines from the middle meet all of them.",
    )
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for axis, axes in enumerate(panels):
        R = rotations.axis_angle_to_matrix(turn[:, None] * torch.eye(3)[axis])
        circle = plane_part(R, axis).numpy()
        axes.plot(*circle.T, color=INK, lw=1.2, label="$R$ itself")
        far = 1.0
        for number, (name, codec) in enumerate(codecs.items()):
            with torch.no_grad():
                loop = plane_part(codec.encode(R).unflatten(-1, (3, 3)), axis).numpy()
            look = {"color": COLOURS[number], "ls": STYLES[1 + number % 3], "lw": 2}
            axes.plot(*loop.T, **look, label=name)
            axes.scatter(*loop[:-1:30].T, s=22, color=COLOURS[number], marker=MARKERS[number],
                         zorder=3)  # fmt: skip
            far = max(far, float(np.linalg.norm(loop, axis=1).max()))
        for x, y in circle[:-1:30]:
            axes.plot([0, 1.1 * far * x], [0, 1.1 * far * y], color="0.75", lw=0.8, zorder=0)
        axes.set(aspect="equal", xlabel="cosine part", title=f"a turn about {'xyz'[axis]}")
    panels[0].set_ylabel("sine part")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=1 + len(codecs))
    return figure


def near_and_far(angles: np.ndarray, distances: Mapping[str, np.ndarray]) -> Picture:
    """Distances of pairs of codes over the angle of their rotations, radians, a panel for each.

    Distances are in units in which a rotation's own are the grey curve.
    """
    ends = "; ".join(
        f"{name}: up to {np.abs(d / _chord(angles) - 1).max():.0%} off the curve"
        for name, d in distances.items()
    )
    figure = new_picture(
        8.2,
        2.6,
        f"A dot for each pair of rotations: further apart, further apart in code space. {ends}.",
    )
    panels = figure.subplots(1, len(distances), sharex=True, sharey=True, squeeze=False)[0]
    line = np.linspace(0, np.pi, 100)
    for axes, (name, d) in zip(panels, distances.items(), strict=True):
        axes.scatter(np.degrees(angles), d, s=3, marker="s", color=COLOURS[0], lw=0,
                     antialiased=False)  # fmt: skip
        axes.plot(np.degrees(line), _chord(line), color=COLOURS[4], lw=2.2, label="$R$ itself")
        axes.set(title=name, xlabel="angle between two rotations, °", xlim=(0, 180), ylim=(0, None))
        axes.set_xticks(range(0, 181, 45))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("distance of their codes / size")
    panels[0].legend(loc="lower right")
    return figure


def training(histories: Mapping[str, np.ndarray]) -> Picture:
    """Error and size (steps, 2) over the steps of several trainings, both on log axes."""
    ends = "; ".join(f"{name}: {h[-1, 0]:.2g}°, size {h[-1, 1]:.2g}" for name, h in
                     histories.items())  # fmt: skip
    figure = new_picture(
        8.2, 3.0, f"Error falls alike, while sizes part in the first steps and stay. {ends}."
    )
    words = {"xlabel": "step", "log": "xy"}
    names = "error, ° (root mean square)", "size of the code"
    for k, (axes, name) in enumerate(zip(figure.subplots(1, 2), names, strict=True)):
        curves = {}
        for label, history in histories.items():
            keep = np.unique(np.geomspace(1, len(history), 300).astype(int)) - 1
            curves[label] = 1 + keep, np.where(history[keep, k] > 0, history[keep, k], np.nan)
        draw_chart(axes, curves, ylabel=name, legend=None if k else "best", **words)
    return figure


def spectra(values: Mapping[str, np.ndarray]) -> Picture:
    """Histograms of the sums of two singular values (N, 3) over their mean, a panel for each."""
    figure = new_picture(
        8.2,
        2.5,
        "Histograms of the sums of two singular values in parts of their mean. "
        + "; ".join(f"{name}: {v.min() / v.mean():.2f} to {v.max() / v.mean():.2f}"
                    for name, v in values.items())
        + ".",
    )  # fmt: skip
    panels = figure.subplots(1, len(values), sharex=True, sharey=True, squeeze=False)[0]
    edges = np.linspace(0, 2, 41)
    for axes, (name, v) in zip(panels, values.items(), strict=True):
        for k, label in enumerate(("$s_2 + s_3$", "$s_1 + s_3$", "$s_1 + s_2$")):
            share = 100 * np.histogram(v[:, k] / v.mean(), edges)[0] / len(v)
            axes.stairs(share, edges, fill=True, color=COLOURS[(0, 4, 2)[k]], alpha=0.5)
            axes.stairs(share, edges, color=INK, ls=STYLES[k], label=label)
        axes.axvline(1, color=INK, lw=0.8)
        axes.set(title=name, xlabel="sum / mean sum", xlim=(0, 2))
    panels[0].set_ylabel("rotations in a bin, %")
    panels[0].legend(fontsize=9)
    return figure


def sizes(names: Sequence[str], degree: Sequence[float]) -> Picture:
    """What an error of one degree adds to the loss of Eq. 10, by target, on a log axis."""
    figure = new_picture(
        6.0,
        0.5 + 0.42 * len(names),
        "Bars of what an error of one degree adds to the loss: "
        + ", ".join(f"{n} {d:.3f}" for n, d in zip(names, degree, strict=True)),
    )
    axes = figure.subplots()
    rows = np.arange(len(names))
    axes.barh(rows, degree, color=COLOURS[0], height=0.6)
    for row, value in zip(rows, degree, strict=True):
        axes.text(1.06 * value, row, f"{value:.3f}", va="center", fontsize=9)
    axes.set(yticks=rows, yticklabels=names, xscale="log", xlabel="loss of an error of 1°")
    axes.set(xlim=(min(degree) / 2, 2.5 * max(degree)))
    axes.invert_yaxis()
    return figure


def one_turn(turn: np.ndarray, targets: Mapping[str, np.ndarray]) -> Picture:
    """The numbers (N, size) that a network has to say along a full turn, a panel for each head."""
    jumps = {name: _jumps(values) for name, values in targets.items()}
    torn = [name for name, places in jumps.items() if len(places)]
    figure = new_picture(
        8.2,
        4.4,
        f"Six panels of curves over a full turn. Torn: {', '.join(torn) or 'none'}. "
        "The others come back to where they began without a jump.",
    )
    panels = figure.subplots(2, 3, sharex=True)
    for axes, (name, values) in zip(panels.flat, targets.items(), strict=True):
        gaps = np.insert(values, jumps[name], np.nan, axis=0)
        places = np.insert(np.degrees(turn), jumps[name], np.nan)
        for k, column in enumerate(gaps.T):
            # Of a matrix, a colour is a row (of two columns, a column): few colours, small files.
            colour = COLOURS[k if len(gaps.T) < 5 else k // 3]
            axes.plot(places, column, STYLES[k % (4 if len(gaps.T) < 5 else 3)], color=colour)
        for place in jumps[name]:
            axes.axvline(np.degrees(turn[place]), color="0.4", lw=0.8)
        state = f"torn {len(jumps[name])} x" if len(jumps[name]) else "whole"
        axes.set_title(f"{name}: {values.shape[1]} numbers, {state}", fontsize=10)
        axes.set(xlim=(0, 360), xticks=range(0, 361, 90))
        axes.grid(alpha=0.3)
    for axes in panels[1]:
        axes.set_xlabel("turned by, °")
    for axes in panels[:, 0]:
        axes.set_ylabel("numbers; angles in rad")
    return figure


def wave_distances(x: np.ndarray, distances: Mapping[str, np.ndarray]) -> Picture:
    """How far apart two numbers are once encoded: matrices (N, N) over x (N,)."""
    figure = new_picture(
        8.2,
        2.9,
        "Maps of the distance of two encoded numbers, dark for near. "
        + "; ".join(f"{name}: the corner that is furthest from the diagonal is "
                    f"{'near' if d[0, -1] < 0.1 * d.max() else 'far'}"
                    for name, d in distances.items())
        + ".",
    )  # fmt: skip
    panels = figure.subplots(1, len(distances), sharey=True)
    ends = (x[0], x[-1], x[0], x[-1])
    for axes, (name, d) in zip(panels, distances.items(), strict=True):
        shades = np.round(d / d.max() * 31)  # few shades keep the page small
        axes.imshow(shades, origin="lower", extent=ends, cmap="cividis", interpolation="nearest")
        axes.set(title=name, xlabel="one number")
    panels[0].set_ylabel("another")
    return figure


def _heat(axes: Axes, block: np.ndarray, *, numbers: bool) -> None:
    limit = max(1.0, float(np.abs(block).max()))
    shades = np.round(block / limit * 6) / 6 * limit  # few colours, small files
    axes.imshow(shades, cmap="cividis", vmin=-limit, vmax=limit, interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    if numbers:
        for (row, column), value in np.ndenumerate(block):
            colour = INK if value > 0 else "white"
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", color=colour,
                      fontsize=8)  # fmt: skip


def _chord(angles: np.ndarray) -> np.ndarray:
    """|R_1 - R_2| of rotations this far apart."""
    return 2 * np.sqrt(2) * np.sin(angles / 2)


def _jumps(values: np.ndarray) -> np.ndarray:
    """Before which rows a curve jumps: steps far beyond the usual."""
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    return 1 + np.flatnonzero(steps > 0.5)
