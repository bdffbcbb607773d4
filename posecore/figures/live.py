"""Curves of a training: as a figure, and while it runs under the cell of a notebook."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.ticker import LogFormatter
from tqdm.std import tqdm

from posecore.arrays import Array, fail, require_integer, to_numbers
from posecore.figures.style import COLOURS, MARKERS, STYLES, Picture, house_style, new_picture

__all__ = ["Display", "Recorded", "training_curves"]

BINS = 200
SECONDS = 1.0
SHARE = 0.05  # of the training's time, which drawing may take


@house_style
def training_curves(
    losses: Mapping[str, Array],
    measured: Mapping[str, Array] | None = None,
    measured_at: Sequence[int] = (),
    *,
    steps: int | None = None,
    alt: str | None = None,
) -> Picture:
    """Losses over the steps of a training, and what was measured on the way.

    A long curve is drawn as the mean of its steps, 200 pieces at most, within the band from the
    smallest to the largest. The axis is logarithmic where all values are positive.

    Args:
        losses: name -> (N,) the value of every step.
        measured: name -> (M,) other numbers, drawn as points in an axis of their own.
        measured_at: (M,) after how many steps.
        steps: the right end of the axis; by default where the curves end.
        alt: what the figure shows, in words; by default where the curves begin and end.

    Returns:
        A figure that belongs to no window.

    Raises:
        ValueError: if there is no step to draw, or lengths differ.
    """
    curves = {name: to_numbers("losses", values) for name, values in losses.items()}
    points = {name: to_numbers("measured", values) for name, values in (measured or {}).items()}
    count = next((values.size for values in curves.values()), 0)
    if count == 0 or any(values.shape != (count,) for values in curves.values()):
        shapes = {name: values.shape for name, values in curves.items()}
        fail("losses", "curves of one length, at least one step", shapes)
    for name, values in points.items():
        if values.shape != (len(measured_at),):
            fail(f"measured[{name!r}]", f"{len(measured_at)} values", f"shape {values.shape}")
    points = points if len(measured_at) else {}
    end = count if steps is None else require_integer("steps", steps, 1)
    ends = [
        f"{name} from {v[0]:.3g} to {v[-1]:.3g}" for name, v in [*curves.items(), *points.items()]
    ]
    default = f"Training curves over {count} steps: {'; '.join(ends)}."
    figure = new_picture(6.4 if not points else 9.6, 3.6, alt, default)
    all_axes = np.atleast_1d(figure.subplots(1, 1 + bool(points)))
    for number, (name, values) in enumerate(curves.items()):
        _draw_curve(all_axes[0], name, values, _look(number))
    for number, (name, values) in enumerate(points.items()):
        look = {**_look(number), "marker": MARKERS[number % len(MARKERS)], "markersize": 4}
        all_axes[1].plot(measured_at, values, label=name, **look)
    for axes, drawn in zip(all_axes, (curves, points), strict=False):
        values = np.concatenate(list(drawn.values()))
        finite = values[np.isfinite(values)]
        label = "loss" if drawn is curves else "measured"
        axes.set(xlabel="step", ylabel=label if len(drawn) > 1 else next(iter(drawn)))
        axes.set_xlim(0, end)
        axes.grid(alpha=0.3)
        if finite.size and finite.min() > 0:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(_Plain())
            axes.yaxis.set_minor_formatter(_Plain())
        if len(drawn) > 1:
            axes.legend(loc="upper right", frameon=True)
    return figure


class _Plain(LogFormatter):
    """Labels the same ticks, and says 60 for 6 times ten to the first."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def _look(number: int) -> dict[str, str]:
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": STYLES[number % len(STYLES)]}


def _draw_curve(axes: Any, name: str, values: np.ndarray, look: dict[str, str]) -> None:
    starts = np.unique(np.linspace(0, len(values), BINS, endpoint=False).astype(int))
    counts = np.diff([*starts, len(values)])
    x = starts + (counts + 1) / 2  # the first step is 1
    axes.plot(x, np.add.reduceat(values, starts) / counts, label=name, linewidth=1.8, **look)
    if len(values) > BINS:
        low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
        axes.fill_between(x, low, high, color=look["color"], alpha=0.2, linewidth=0)


class Recorded(Protocol):
    """What `Display` looks at: a `posecore.training.History`."""

    losses: dict[str, list[float]]
    measured: dict[str, list[float]]
    measured_at: list[int]


class Display:
    """A progress bar, and in a notebook a curve under the cell, which stays as a still picture.

    The curve is drawn anew every second, less often if drawing would then take over a twentieth of
    the time. Nothing is written where nobody looks: into a file or a pipe.

        with Display(steps, history) as display:
            for step in range(steps):
                ...  # a step, recorded in history
                display.update()

    Args:
        steps: how many there will be; those in `history` are behind already.
        history: what is drawn.
        show: whether to show anything; None is where somebody looks. The curve needs a notebook.
    """

    def __init__(self, steps: int, history: Recorded, show: bool | None = None) -> None:
        self.steps, self.history = steps, history
        in_notebook = _in_notebook()
        visible = in_notebook or sys.stderr.isatty() if show is None else show
        self._curve = _Replaced() if visible and in_notebook else None
        behind = len(next(iter(history.losses.values()), ()))
        self._bar = tqdm(
            total=steps, initial=behind, disable=not visible, leave=False, dynamic_ncols=True
        )
        self._next = time.perf_counter() + SECONDS

    def __enter__(self) -> Display:
        return self

    def update(self) -> None:
        """Show one step more."""
        self._bar.update()
        now = time.perf_counter()
        if not self._bar.disable and now >= self._next:
            self._bar.set_postfix({n: f"{v[-1]:.3g}" for n, v in self.history.losses.items()})
            self._draw()
            after = time.perf_counter()
            self._next = after + max(SECONDS, (after - now) * (1 / SHARE - 1))

    def __exit__(self, *error: object) -> None:
        self._bar.close()
        if any(self.history.losses.values()):
            self._draw()

    def _draw(self) -> None:
        if self._curve is not None:
            history = self.history
            self._curve.show(
                training_curves(
                    history.losses, history.measured, history.measured_at, steps=self.steps
                )
            )


class _Replaced:
    """A place under the cell where each picture takes that of the one before."""

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, picture: Picture) -> None:
        from IPython.display import display

        # Said outright, since a Picture that shows itself takes a new place every time.
        data, metadata = picture._repr_mimebundle_()
        if self._handle is None:
            self._handle = display(data, metadata=metadata, raw=True, display_id=True)
        else:
            self._handle.update(data, metadata=metadata, raw=True)


def _in_notebook() -> bool:
    """Whether a cell runs in a kernel, which can show and replace pictures."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return getattr(shell, "kernel", None) is not None
