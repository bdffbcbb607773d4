"""The files from which a training goes on: whole or absent, and what is damaged is named.

A checkpoint is two files. `weights-STEP.safetensors` holds the model's weights for anybody to load,
`state-STEP.pt` what else the run needs. The second is written last and holds the hash of the first:
together they count or not at all. The checkpoint before the newest is kept.
"""

from __future__ import annotations

import hashlib
import io
import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from posecore import weights
from posecore.arrays import fail
from posecore.files import require_path, write_bytes
from posecore.training.origins import Part, difference

__all__ = ["Checkpoints"]

OURS = re.compile(r"(weights-\d{8}\.safetensors|state-\d{8}\.pt)")
HASH_BYTES = hashlib.sha256().digest_size


class Checkpoints:
    """The checkpoints in a folder, all of one run; one process at a time may write them.

    Args:
        folder: made by the first `save`; None keeps none.
        settings: what a run must have in common with the one that it goes on from.
        model: whose weights are kept.
        parts: what else goes on, by name; each has `state_dict` and `load_state_dict`.
        origins: gives what the run is made from (`origins.origins`). What comes out otherwise
            while the run goes on is state, and counts no more. A run of before such were kept is
            taken as it is.
        writes: whether `save` does anything; of several processes only one may, and only it looks
            at the origins.

    Raises:
        ValueError: if `folder` is a file, or no name of a folder.
    """

    def __init__(
        self,
        folder: str | Path | None,
        settings: Mapping[str, str],
        model: nn.Module,
        parts: Mapping[str, Any],
        *,
        origins: Callable[[], Mapping[str, Part]] = dict,
        writes: bool = True,
    ) -> None:
        self.folder = None if folder is None else require_path("resume", folder)
        if self.folder is not None and self.folder.exists() and not self.folder.is_dir():
            fail("resume", "a folder", f"the file {str(folder)!r}")
        self.settings, self.model, self.parts = dict(settings), model, dict(parts)
        self.writes, self._origins_now = writes, origins
        self.origins = dict(origins()) if writes and folder is not None else {}

    def save(self, step: int) -> None:
        """Write the checkpoint after so many steps; those before it stay until it is whole.

        Raises:
            OSError: if it cannot be written; the checkpoints of before are untouched.
        """
        if self.folder is None or not self.writes:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        packed = weights.pack(self.model.state_dict())
        state = {name: part.state_dict() for name, part in self.parts.items()}
        state |= {
            "settings": self.settings,
            "origins": self._constant_origins() if step else self.origins,
            "weights": hashlib.sha256(packed).hexdigest(),
        }
        buffer = io.BytesIO()
        torch.save(state, buffer)
        data = buffer.getvalue()
        older = [number for number in self._steps() if number < step][:1]
        weights_file, state_file = self._files(step)
        write_bytes(weights_file, packed)
        write_bytes(state_file, hashlib.sha256(data).digest() + data)
        self._keep({step, *older})

    def load(self, again_after: int | None = None) -> int:
        """Make the run what it was at the newest whole checkpoint.

        A damaged one is named in a warning, and the one before it is taken.

        Args:
            again_after: a checkpoint after so many steps is not taken, nor one before it.

        Returns:
            After how many steps that was; 0 also where there is no checkpoint.

        Raises:
            ValueError: if it belongs to a run with other settings, or has been trained with another
                loss, other data or another schedule; the message names the first.
        """
        steps = self._steps()
        for step in steps:
            try:
                tensors, state = self._read(step)
            except (ValueError, OSError) as error:
                onwards = "goes on from before it" if step > steps[-1] else "begins anew"
                warnings.warn(f"{error}; training {onwards}", stacklevel=3)
                continue
            self._require_same(state["settings"])
            if step == again_after:
                break
            if step:  # before the first step nothing has been made of them
                self._require_same_origins(state.get("origins"))
            try:
                self.model.load_state_dict(tensors)
            except RuntimeError as error:
                fail("resume", "a run with this model", " ".join(f"{self.folder}: {error}".split()))
            for name, part in self.parts.items():
                part.load_state_dict(state[name])
            return step
        return 0

    def _read(self, step: int) -> tuple[dict[str, Tensor], dict[str, Any]]:
        weights_file, state_file = self._files(step)
        sealed = state_file.read_bytes()
        data = sealed[HASH_BYTES:]
        if hashlib.sha256(data).digest() != sealed[:HASH_BYTES]:
            raise ValueError(f"{state_file} is damaged")
        state = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        packed = weights_file.read_bytes()
        if hashlib.sha256(packed).hexdigest() != state["weights"]:
            raise ValueError(f"{weights_file} is damaged")
        return weights.parse(packed), state

    def _require_same(self, found: Mapping[str, str]) -> None:
        for name in [*self.settings, *found]:
            ours, theirs = self.settings.get(name, "absent"), found.get(name, "absent")
            if ours != theirs:
                fail("resume", f"a run with {name} {ours}, as now", f"{theirs} in {self.folder}")

    def _require_same_origins(self, found: Mapping[str, Part] | None) -> None:
        if self.origins and found is not None:
            if name := difference(found, self.origins):
                got = f"one of another in {self.folder}; a new folder begins anew"
                fail("resume", f"a run of the same {name}", got)
            self.origins = {name: part for name, part in self.origins.items() if name in found}

    def _constant_origins(self) -> dict[str, Part]:
        """Those that are still as they were when the run began."""
        now = self._origins_now()
        self.origins = {name: part for name, part in self.origins.items() if now.get(name) == part}
        return self.origins

    def _files(self, step: int) -> tuple[Path, Path]:
        return (
            self.folder / f"weights-{step:08}.safetensors",
            self.folder / f"state-{step:08}.pt",
        )

    def _steps(self) -> list[int]:
        """The steps whose state was written, newest first."""
        if self.folder is None:
            return []
        found = (path.name for path in self.folder.glob("state-*.pt"))
        return sorted((int(name[6:14]) for name in found if OURS.fullmatch(name)), reverse=True)

    def _keep(self, steps: set[int]) -> None:
        """Delete other checkpoints, and what writers that were killed have left."""
        kept = {path.name for step in steps for path in self._files(step)}
        # A state goes before its weights, lest it be taken for a damaged one.
        for path in sorted(self.folder.iterdir() if self.folder.is_dir() else []):
            unfinished = re.fullmatch(rf"\.{OURS.pattern}\.[0-9a-f]{{16}}\.tmp", path.name)
            if unfinished or (OURS.fullmatch(path.name) and path.name not in kept):
                path.unlink(missing_ok=True)
