"""The figures of chapter 5 on six and nine numbers: Gram-Schmidt and Procrustes."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from posecore import rotations
from posecore.figures import Picture, chart
from posecore.figures.style import AXIS_COLOURS, COLOURS, HALO, INK, new_picture

__all__ = ["autograd_fails", "gram_schmidt", "on_a_line", "screws", "shaken"]

# From the right, in front and above: right, up, towards the reader.
VIEW = np.array([[-0.6, 0.8, 0.0], [-0.32, -0.24, 0.92], [0.73, 0.55, 0.4]])
VIEW = rotations.special_procrustes(VIEW)


def gram_schmidt(a: np.ndarray, b: np.ndarray) -> Picture:
    """From two vectors `a` (2, 3) to three at right angles, the columns of `b` (3, 3)."""
    cosine = a[0] @ a[1] / np.linalg.norm(a[0]) / np.linalg.norm(a[1])
    figure = new_picture(
        9.0,
        3.1,
        "Three steps in space. First: two arrows a1 and a2 from one point, of different lengths, "
        f"{np.degrees(np.arccos(cosine)):.0f} degrees apart. Second: a1 shortened to the unit "
        "vector b1, and from a2 its part along b1 taken away; what is left, at right angles to b1, "
        "shortened to b2. Third: b3 stands on both, and the three are the axes of a frame.",
    )
    panels = figure.subplots(1, 3)
    titles = ("six numbers, two vectors", "shorten; take away", "the third follows")
    for axes, title in zip(panels, titles, strict=True):
        axes.set(aspect="equal", xlim=(-1.0, 1.35), ylim=(-0.55, 1.3))
        axes.set_title(title, fontsize=11)
        axes.axis("off")
    grey = {"colour": "0.65", "lw": 1.4}
    for axes, look in ((panels[0], {"colour": INK}), (panels[1], grey)):
        for k in (0, 1):
            _arrow(axes, np.zeros(3), a[k], f"$a_{k + 1}$", **look)
    along = (b[:, 0] @ a[1]) * b[:, 0]
    ends = np.array([a[1], a[1] - along]) @ VIEW.T
    panels[1].plot(*ends[:, :2].T, color="0.4", ls=":", lw=1.6)
    colours = list(AXIS_COLOURS.values())
    for axes, count in ((panels[1], 2), (panels[2], 3)):
        for k in range(count):
            _arrow(axes, np.zeros(3), b[:, k], f"$b_{k + 1}$", colour=colours[k], lw=2.8)
    return figure


def on_a_line(trace: np.ndarray, squared: np.ndarray, best: tuple[float, float]) -> Picture:
    """Squared distances from M of many rotations over tr(R^T M), and the nearest rotation."""
    return chart(
        {},
        marks={"random rotations": (trace, squared), "$U D V^T$": ([best[0]], [best[1]])},
        looks={
            "random rotations": {"marker": ".", "ms": 3},
            "$U D V^T$": {"marker": "o", "ms": 11, "mfc": "none", "mew": 2.4},
        },
        xlabel=r"tr$(R^T M)$",
        ylabel=r"$\|R - M\|_F^2$",
        legend={"frameon": False},
        size=(5.6, 3.4),
        alt=f"{len(trace)} random rotations as dots: the larger the trace of R transposed times M, "
        "the smaller the squared distance to M, all on one falling line. A ring at the line's "
        f"lower end, at trace {best[0]:.2f} and distance {best[1]:.2f}, is the answer of the "
        "formula; no dot lies beyond it.",
    )


def screws(raw: np.ndarray, mended: np.ndarray) -> Picture:
    """What UV^T makes of a right-handed screw, and what the mended formula makes of it.

    Args:
        raw: (N, 3, 3) orthogonal matrices.
        mended: (N, 3, 3) rotations.
    """
    left = [np.linalg.det(Q) < 0 for Q in raw]
    figure = new_picture(
        9.6,
        2.9,
        f"Two rows of {len(raw)} screws. In the upper row, made by U V transposed, {sum(left)} are "
        "left-handed, drawn in orange with a dashed rod: mirror images, which no turning makes of "
        "a right-handed screw. In the lower row, made with the sign mended, all are right-handed.",
    )
    panels = figure.subplots(2, len(raw), squeeze=False)
    for row, matrices in zip(panels, (raw, mended), strict=True):
        for axes, Q in zip(row, matrices, strict=True):
            mirrored = bool(np.linalg.det(Q) < 0)
            _screw(axes, Q, mirrored)
            axes.set_title("left-handed" if mirrored else "right-handed", fontsize=8.5)
            axes.set(aspect="equal", xlim=(-1.35, 1.35), ylim=(-1.35, 1.35), xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
    panels[0, 0].set_ylabel("$U V^T$", fontsize=12)
    panels[1, 0].set_ylabel("$U D V^T$", fontsize=12)
    return figure


def autograd_fails(distance: np.ndarray, errors: Mapping[str, np.ndarray]) -> Picture:
    """Median relative errors (N,) of gradients over the distance of M from a rotation."""

    def said(k: int) -> str:
        return ", ".join(
            f"{n} {f'{e[k]:.1g}' if e[k] < np.inf else 'NaN'}" for n, e in errors.items()
        )

    looks = {name: {"color": c, "ls": "-"} for name, c in zip(errors, COLOURS[1::-1], strict=False)}
    figure = chart(
        errors,
        x=distance,
        markers=True,
        looks=looks,
        log="xy",
        xlabel="distance of $M$ from a rotation",
        ylabel="relative error of the gradient",
        ylim=(1e-8, 1.5),
        legend={"frameon": False},
        size=(6.6, 3.4),
        alt="Error of the gradient over the distance of M from a rotation, both axes logarithmic. "
        f"At {distance[0]:g}: {said(0)}. At {distance[1]:g}: {said(1)}. At {distance[-1]:g}: "
        f"{said(-1)}.",
    )
    for name, error in errors.items():
        for place in distance[np.isinf(error)]:
            look = {"color": looks[name]["color"], "ha": "center", "va": "top", "fontsize": 11}
            figure.axes[0].text(place, 0.9, "NaN", **look)
    return figure


def shaken(
    kinds: Mapping[str, np.ndarray],
    frames: Mapping[str, np.ndarray],
    gap: np.ndarray,
    turned: np.ndarray,
    noise: float,
) -> Picture:
    """How noise of one size in M turns the rotation.

    Args:
        kinds: name -> singular values (3,), the last with the sign of det M.
        frames: name -> (N, 3, 3) nearest rotations of M = diag(s) with noise.
        gap: (K,) s_2 + s_3 of random matrices.
        turned: (K,) degrees by which noise has turned their nearest rotation.
        noise: Frobenius norm of the noise there.
    """
    off = {
        name: np.degrees(rotations.geodesic_distance(R, np.eye(3))) for name, R in frames.items()
    }
    said = "; ".join(f"{name}: {np.median(angles):.0f} degrees" for name, angles in off.items())
    figure = new_picture(
        9.6,
        5.6,
        "Above: four ellipsoids, the images of a ball under M, each with the frames of the nearest "
        "rotations when M is shaken by the same noise. The frames of the ball and of the pancake "
        "stay together; those of the needle fan out about its long axis; those of the mirrored "
        f"ball fan out too. Median turn, {said}. Below: turns of random matrices over s2 + s3, on "
        "log axes; they keep under a falling line, the bound.",
    )
    grid = figure.add_gridspec(2, 4, height_ratios=[1, 1.25])
    for k, (name, s) in enumerate(kinds.items()):
        axes = figure.add_subplot(grid[0, k])
        _ellipsoid(axes, s)
        for R in frames[name]:
            for column, colour in zip(R.T, AXIS_COLOURS.values(), strict=True):
                # Without soft edges, which would triple the size of the file.
                end = (VIEW @ column)[:2]
                axes.plot(*np.outer(end, [0, 1.15]), color=colour, lw=0.9, antialiased=False)
        values = ", ".join(f"{value:g}" for value in s).replace("-", "\N{MINUS SIGN}")
        axes.set_title(f"{name}\ns = {values}\nturned {np.median(off[name]):.0f}°", fontsize=10)
        axes.set(aspect="equal", xlim=(-1.25, 1.25), ylim=(-1.25, 1.25))
        axes.axis("off")
    axes = figure.add_subplot(grid[1, :])
    axes.loglog(
        gap,
        turned,
        ".",
        color=COLOURS[0],
        ms=3,
        label="random matrices, random noise",
        antialiased=False,
    )
    line = np.geomspace(gap.min(), gap.max(), 50)
    bound = np.degrees(np.sqrt(2) * noise / line)
    axes.loglog(line, bound, color=COLOURS[1], label=r"$\sqrt{2}\,\|dM\| / (s_2 + s_3)$")
    axes.set(xlabel="$s_2 + s_3$", ylabel="turned by, degrees")
    axes.legend(frameon=False)
    return figure


def _arrow(
    axes: Axes, start: np.ndarray, end: np.ndarray, label: str, colour: str, lw: float = 2.0
) -> None:
    start, end = VIEW @ start, VIEW @ end
    style = {"arrowstyle": "-|>", "color": colour, "lw": lw, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end[:2], start[:2], arrowprops=style)
    outwards = 9 * (end - start)[:2] / np.linalg.norm(end - start)
    axes.annotate(label, end[:2], xytext=outwards, textcoords="offset points", color=colour,
                  ha="center", va="center", fontsize=12, path_effects=HALO)  # fmt: skip


def _screw(axes: Axes, Q: np.ndarray, mirrored: bool) -> None:
    """Three windings about a rod with a tip, far parts thin and near ones thick."""
    angle = np.linspace(0, 6 * np.pi, 160)
    thread = np.stack([0.42 * np.cos(angle), 0.42 * np.sin(angle), np.linspace(-0.85, 0.85, 160)])
    rod = np.stack([0 * angle, 0 * angle, np.linspace(-1.0, 1.2, 160)])
    lines, depths, colours, widths = [], [], [], []
    for curve, colour, wide in ((rod, "0.55", 2.2), (thread, COLOURS[mirrored], 3.0)):
        x, y, depth = VIEW @ Q @ curve
        for k in range(len(x) - 1):
            if mirrored and curve is rod and k % 16 > 9:
                continue
            lines.append([(x[k], y[k]), (x[k + 1], y[k + 1])])
            depths.append(depth[k])
            colours.append(colour)
            widths.append(wide * (0.35 + np.clip(0.5 + depth[k] / 1.2, 0.15, 1)))
    order = np.argsort(depths, kind="stable")
    lines, colours, widths = ([part[k] for k in order] for part in (lines, colours, widths))
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=widths, capstyle="round"))
    axes.plot(*(VIEW @ Q @ rod[:, -1])[:2], "o", color=INK, ms=4)


def _ellipsoid(axes: Axes, s: np.ndarray) -> None:
    """The outline of diag(s) times the unit ball, and of its three great circles."""
    turn = np.linspace(0, 2 * np.pi, 90)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn])
    for k in range(3):
        circle = VIEW @ (s[:, None] * np.roll(ring, k, 0))
        axes.plot(circle[0], circle[1], color="0.75", lw=0.9)
    half = (VIEW * s)[:2]  # the shadow of an ellipsoid is an ellipse
    values, vectors = np.linalg.eigh(half @ half.T)
    outline = vectors @ (np.sqrt(values)[:, None] * ring[:2])
    axes.fill(*outline, fc="0.93", ec="0.4", lw=1.2, zorder=0)
