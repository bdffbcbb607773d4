"""A run of `train vector_field`: the network of the field `net`, and after it the `refiner`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from posecore.arrays import fail, require_integer
from posecore.methods import runs
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.models import ObjectModel, require_models

__all__ = ["VectorFieldRun", "read_run"]

RENAMED = {"begin": "warmup", "forward_only": "ignore_reversed"}
"""Options that had other names when older runs were written."""


@dataclass(frozen=True)
class VectorFieldRun(runs.Run):
    """A run as its folder has it.

    Attributes:
        path, options: as of every `Run`.
        width, max_channels: of the network of the field.
        refiner_width: None for no refiner.
        image_width: to which images are reduced; None leaves them as they are.
        models: of the objects.
    """

    method: ClassVar[str] = "vector_field"

    width: int
    max_channels: int | None
    refiner_width: int | None
    image_width: int | None
    models: list[ObjectModel]

    @property
    def object_ids(self) -> list[int]:
        """The objects that it knows, in the order of its network."""
        return [model.object_id for model in self.models]

    def new_net(self) -> VectorFieldNet:
        """The network of the field, untrained."""
        keypoints = len(self.models[0].keypoints)
        return VectorFieldNet(len(self.models), keypoints, self.width, self.max_channels)

    def new_refiner(self) -> FieldRefiner:
        """The refiner, untrained.

        Raises:
            ValueError: if the run has none.
        """
        if self.refiner_width is None:
            fail("--run", "a run with a refiner, or --system OPEPL", f"{self.path} without one")
        return FieldRefiner(self.models, width=self.refiner_width)


def read_run(path: str | Path) -> VectorFieldRun:
    """Read what `VectorFieldRun.write` wrote.

    Raises:
        ValueError: naming the file, if there is none or it is damaged.
    """
    return runs.read_run(path, VectorFieldRun, _run)


def _run(path: Path, content: dict[str, Any]) -> VectorFieldRun:
    models = require_models([ObjectModel(**entry) for entry in content["models"]])
    options = {RENAMED.get(name, name): value for name, value in content["options"].items()}
    most = content["max_channels"] if "max_channels" in content else content["most"]
    sizes = content["width"], most, content["refiner_width"], content.get("image_width")
    if sizes[3] is not None:
        require_integer("image_width", sizes[3], 1)
    run = VectorFieldRun(path, options, *sizes, models)
    run.new_net()  # refuses sizes that cannot be
    if run.refiner_width is not None:
        run.new_refiner()
    return run
