"""The folder of a run of `train vector_field`, from which its models can be made again.

RUN/run.json              options, sizes, and what has to be known of the objects
RUN/net.safetensors       the network of the field, when it is trained
RUN/refiner.safetensors   the refiner, when it is trained
RUN/checkpoints           where a training that was stopped goes on
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
from torch import nn

from data_tools.bop.files import read_json
from posecore.arrays import fail
from posecore.files import write_bytes
from posecore.methods.vector_field.models import ObjectModel, require_models
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner

__all__ = ["Run", "read_run"]

METHOD = "vector_field"


@dataclass(frozen=True)
class Run:
    """A run as its folder has it.

    Attributes:
        path: of the folder.
        options: of the command that began it, by name.
        width, most: of the network of the field.
        refiner_width: None for no refiner.
        models: of the objects.
    """

    path: Path
    options: Mapping[str, Any]
    width: int
    most: int | None
    refiner_width: int | None
    models: list[ObjectModel]

    def new_net(self) -> VectorFieldNet:
        """The network of the field, untrained."""
        keypoints = len(self.models[0].keypoints)
        return VectorFieldNet(len(self.models), keypoints, self.width, self.most)

    def new_refiner(self) -> FieldRefiner:
        """The refiner, untrained.

        Raises:
            ValueError: if the run has none.
        """
        if self.refiner_width is None:
            fail("--run", "a run with a refiner, or --system OPEPL", f"{self.path} without one")
        return FieldRefiner(self.models, width=self.refiner_width)

    def write(self) -> None:
        """Write all but the weights.

        Raises:
            OSError: if it cannot be written.
        """
        content = {"method": METHOD} | {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name != "path"
        }
        content["models"] = [
            {name: _plain(value) for name, value in vars(model).items()} for model in self.models
        ]
        self.path.mkdir(parents=True, exist_ok=True)
        write_bytes(self.path / "run.json", json.dumps(content, allow_nan=False).encode())

    def write_weights(self, name: str, model: nn.Module) -> None:
        """Write `NAME.safetensors`.

        Raises:
            OSError: if it cannot be written.
        """
        weights = {key: value.cpu().contiguous() for key, value in model.state_dict().items()}
        write_bytes(self.path / f"{name}.safetensors", safetensors.torch.save(weights))

    def load_weights(self, name: str, model: nn.Module) -> None:
        """Give a model the weights of `NAME.safetensors`, and leave it in evaluation mode.

        Raises:
            ValueError: if there is no such file, it is damaged, or of another model.
        """
        path = self.path / f"{name}.safetensors"
        if not path.is_file():
            fail("--run", f"a run that has trained its {name}", f"no {path}")
        try:
            weights = safetensors.torch.load(path.read_bytes())
            model.load_state_dict(weights)
        except (safetensors.SafetensorError, RuntimeError) as error:
            words = " ".join(str(error).split())
            raise ValueError(f"{path}: expected the weights of this run: {words}") from error
        wrong = [key for key, value in weights.items() if not value.isfinite().all()]
        if wrong:
            raise ValueError(f"{path}: expected finite weights, got others in {wrong[0]}")
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


def read_run(path: str | Path) -> Run:
    """Read what `Run.write` wrote.

    Raises:
        ValueError: naming the file, if there is none or it is damaged.
    """
    file = Path(path) / "run.json"
    if not file.is_file():
        fail("--run", f"a folder that `train {METHOD}` wrote", f"no {file}")
    content = read_json(file)
    try:
        if content["method"] != METHOD:
            fail("method", METHOD, content["method"])
        models = require_models([ObjectModel(**entry) for entry in content["models"]])
        run = Run(Path(path), dict(content["options"]), content["width"], content["most"],
                  content["refiner_width"], models)  # fmt: skip
        run.new_net()
        if run.refiner_width is not None:
            run.new_refiner()
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        words = " ".join(str(error).split())
        raise ValueError(f"{file}: damaged: {type(error).__name__}: {words}") from error
    return run


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
