"""The folder of a run of `train METHOD`, from which its networks can be made again.

RUN/run.json           the method, its options and sizes, and what has to be known of the objects
RUN/NAME.safetensors   a network, when it is trained, with the digest of its weights
RUN/checkpoints/NAME   where its training goes on if it was stopped
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from torch import nn

from data_tools.bop.files import read_json
from posecore import weights
from posecore.arrays import fail, require_choice, require_integer
from posecore.files import write_bytes
from posecore.scale import SCALES

__all__ = ["NetRun", "Run", "read_net_run", "read_run", "resumed"]


@dataclass(frozen=True)
class Run:
    """A run as its folder has it; a method's own adds sizes, objects and networks.

    Attributes:
        method: its name, of the class.
        path: of the folder.
        options: of the command that began it, by name.
    """

    method: ClassVar[str]

    path: Path
    options: Mapping[str, Any]

    @property
    def object_ids(self) -> list[int]:
        """The objects that it knows."""
        raise NotImplementedError

    def write(self) -> None:
        """Write all but the weights.

        Raises:
            OSError: if it cannot be written.
        """
        content = {"method": self.method} | {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name != "path"
        }
        self.path.mkdir(parents=True, exist_ok=True)
        text = json.dumps(content, allow_nan=False, default=_plain)
        write_bytes(self.path / "run.json", text.encode())

    def write_weights(self, name: str, model: nn.Module) -> None:
        """Write `NAME.safetensors`.

        Raises:
            OSError: if it cannot be written.
        """
        write_bytes(self.path / f"{name}.safetensors", weights.pack(model.state_dict()))

    def load_weights(self, name: str, model: nn.Module) -> None:
        """Give a model the weights of `NAME.safetensors`, and leave it in evaluation mode.

        Raises:
            ValueError: if there is no such file, it is damaged or of another model, or its weights
                are not finite, of another dtype, or others than were written.
        """
        path = self.path / f"{name}.safetensors"
        if not path.is_file():
            fail("--run", f"a run that has trained its {name}", f"no {path}")
        try:
            weights.fill(model, weights.unpack(path.read_bytes()))
        except (ValueError, RuntimeError) as error:
            words = _few_names(" ".join(str(error).split()))
            if words.startswith("expected"):
                raise ValueError(f"{path}: {words}") from error
            raise ValueError(f"{path}: expected the weights of this run, got {words}") from error
        model.eval()

    def require_options(self, wanted: Mapping[str, Any]) -> None:
        """Refuse to go on with other options than those of the beginning.

        Raises:
            ValueError: naming the first one that differs.
        """
        for name, value in wanted.items():
            begun = self.options.get(name)
            if begun != value:
                option = "--" + name.replace("_", "-")
                fail(option, f"{begun} as {self.path} was begun with, or another --out", value)


@dataclass(frozen=True)
class NetRun(Run):
    """A run of one network `net` for all objects.

    Attributes:
        kind: which of the method's networks, a name in `NETS`.
        net: the keyword arguments of that network.
        objects: those that it was trained on, ascending.
    """

    NETS: ClassVar[Mapping[str, Callable[..., nn.Module]]]

    kind: str
    net: Mapping[str, Any]
    objects: list[int]

    @property
    def object_ids(self) -> list[int]:
        """The objects that it was trained on."""
        return self.objects

    def new_net(self) -> nn.Module:
        """The network, untrained."""
        return self.NETS[self.kind](**self.net)

    def load_net(self) -> nn.Module:
        """The network, trained.

        Raises:
            ValueError: if it is not there, or damaged.
        """
        net = self.new_net()
        self.load_weights("net", net)
        return net


SomeRun = TypeVar("SomeRun", bound=Run)
SomeNetRun = TypeVar("SomeNetRun", bound=NetRun)


def read_run(
    path: str | Path, kind: type[SomeRun], make: Callable[[Path, dict[str, Any]], SomeRun]
) -> SomeRun:
    """Read what `Run.write` wrote.

    Args:
        path: of the folder.
        kind: of run, which knows its method.
        make: `make(path, content)` makes one of what `run.json` holds.

    Raises:
        ValueError: naming the file, if there is none, it is damaged, or of another method.
    """
    file = Path(path) / "run.json"
    if not file.is_file():
        fail("--run", f"a folder that `train {kind.method}` wrote", f"no {file}")
    content = read_json(file)
    try:
        for name in ("method", "options"):
            if not isinstance(content, dict) or name not in content:
                fail(name, "an entry of this name", "none")
        if content["method"] != kind.method:
            fail("method", kind.method, content["method"])
        options = content["options"]
        if not isinstance(options, dict):
            fail("options", "options by their names", type(options).__name__)
        if (scale := options.get("scale")) is not None:
            require_choice("scale", scale, SCALES)
        return make(Path(path), content)
    except (ArithmeticError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError,
            ValueError) as error:  # fmt: skip
        words = " ".join(str(error).split())[:300]
        if isinstance(error, KeyError):
            words = f"no entry {words}"
        elif not isinstance(error, ValueError):  # whose words may say nothing by themselves
            words = f"{type(error).__name__}: {words}"
        raise ValueError(f"{file}: damaged: {words}") from error


def read_net_run(path: str | Path, kind: type[SomeNetRun]) -> SomeNetRun:
    """Read what `NetRun.write` wrote, of any method whose run it is.

    Args:
        path: of the folder.
        kind: of run. It refuses numbers of its own that cannot be when it is made.

    Raises:
        ValueError: naming the file, if there is none, it is damaged, or of another method.
    """

    def make(path: Path, content: dict[str, Any]) -> SomeNetRun:
        require_choice("kind", content["kind"], list(kind.NETS))
        for number in content["objects"] or fail("objects", "one or more", content["objects"]):
            require_integer("objects", number, 0)
        names = {field.name for field in dataclasses.fields(kind)} - {"path"}
        run = kind(path=path, **{name: content[name] for name in sorted(names)})
        run.new_net()  # refuses sizes that cannot be
        return run

    return read_run(path, kind, make)


def resumed(
    path: Path, options: Mapping[str, Any], read: Callable[[Path], SomeRun]
) -> SomeRun | None:
    """The run that was begun in a folder with these options, to go on with; None for a new one.

    Raises:
        ValueError: if it was begun with others, or is damaged.
    """
    if not (path / "run.json").exists():
        return None
    run = read(path)
    run.require_options(options)
    return run


def _few_names(words: str) -> str:
    """An error of PyTorch with few of the names that it lists: of another network all differ."""

    def cut(found: re.Match[str]) -> str:
        names = found[0].split(", ")
        return ", ".join(names[:3]) + f" and {len(names) - 3} more"

    words = re.sub(r'"[^"]+"(, "[^"]+"){3,}', cut, words)
    return words if len(words) <= 600 else words[:597] + "..."


def _plain(value: object) -> Any:
    """What JSON has no word for."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if dataclasses.is_dataclass(value):
        return vars(value)
    raise TypeError(f"expected numbers, texts, arrays and dataclasses, got {type(value).__name__}")
