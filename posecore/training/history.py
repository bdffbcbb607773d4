"""What was recorded while a network was trained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from posecore.arrays import fail
from posecore.figures.live import training_curves
from posecore.figures.style import Picture

__all__ = ["History"]


@dataclass(repr=False)
class History:
    """Curves of a training, whole also where it was interrupted.

    Attributes:
        losses: name -> the value of every step; "loss" is what was minimised.
        measured: name -> the values that `evaluate` gave.
        measured_at: after how many steps each.
        seconds: how long it took, all its parts together.
    """

    losses: dict[str, list[float]] = field(default_factory=dict)
    measured: dict[str, list[float]] = field(default_factory=dict)
    measured_at: list[int] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def steps(self) -> int:
        """How many steps were made."""
        return len(self.losses.get("loss", ()))

    def __repr__(self) -> str:
        # One batch more or less lucky says little: the mean over the last tenth.
        ends = [f"{name} {_last(values):.4g}" for name, values in self.losses.items()]
        ends += [f"{name} {values[-1]:.4g}" for name, values in self.measured.items()]
        return f"{self.steps} steps in {self.seconds:.0f} s: {', '.join(ends) or 'nothing yet'}"

    def record(self, losses: Mapping[str, float]) -> None:
        """Add the losses of a step.

        Raises:
            ValueError: if their names are not those of the first step.
        """
        if self.losses and losses.keys() != self.losses.keys():
            fail("loss", f"the parts {sorted(self.losses)} at every step", sorted(losses))
        for name, value in losses.items():
            self.losses.setdefault(name, []).append(value)

    def measure(self, done: int, values: Mapping[str, float]) -> None:
        """Add what was measured after `done` steps.

        Raises:
            ValueError: if its names are not those of the first time.
        """
        if self.measured and values.keys() != self.measured.keys():
            fail("evaluate", f"the names {sorted(self.measured)} every time", sorted(values))
        self.measured_at.append(done)
        for name, value in values.items():
            self.measured.setdefault(name, []).append(value)

    def plot(self, alt: str | None = None) -> Picture:
        """Losses, and what was measured, over the steps.

        Args:
            alt: what the figure shows, in words; by default where the curves begin and end.

        Raises:
            ValueError: if there was no step yet.
        """
        return training_curves(self.losses, self.measured, self.measured_at, alt=alt)

    def state_dict(self) -> dict[str, Any]:
        """All of it, as plain numbers and tensors."""
        packed = {
            kind: {name: torch.tensor(values, dtype=torch.float64) for name, values in some.items()}
            for kind, some in (("losses", self.losses), ("measured", self.measured))
        }
        return packed | {"measured_at": list(self.measured_at), "seconds": self.seconds}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Become the history whose `state_dict` this is."""
        self.losses = {name: values.tolist() for name, values in state["losses"].items()}
        self.measured = {name: values.tolist() for name, values in state["measured"].items()}
        self.measured_at, self.seconds = list(state["measured_at"]), state["seconds"]


def _last(values: list[float]) -> float:
    return float(np.mean(values[-max(1, len(values) // 10) :]))
