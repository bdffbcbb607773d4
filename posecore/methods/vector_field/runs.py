"""A run of `train vector_field`: the network of the field `net`, and after it the `refiner`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from posecore.arrays import fail
from posecore.methods import runs
from posecore.methods.vector_field.models import ObjectModel, require_models
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner

__all__ = ["VectorFieldRun", "read_run"]


@dataclass(frozen=True)
class VectorFieldRun(runs.Run):
    """A run as its folder has it.

    Attributes:
        path, options: as of every `Run`.
        width, most: of the network of the field.
        refiner_width: None for no refiner.
        models: of the objects.
    """

    method: ClassVar[str] = "vector_field"

    width: int
    most: int | None
    refiner_width: int | None
    models: list[ObjectModel]

    @property
    def object_ids(self) -> list[int]:
        """The objects that it knows, in the order of its network."""
        return [model.object_id for model in self.models]

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


def read_run(path: str | Path) -> VectorFieldRun:
    """Read what `VectorFieldRun.write` wrote.

    Raises:
        ValueError: naming the file, if there is none or it is damaged.
    """
    return runs.read_run(path, VectorFieldRun, _run)


def _run(path: Path, content: dict[str, Any]) -> VectorFieldRun:
    models = require_models([ObjectModel(**entry) for entry in content["models"]])
    sizes = content["width"], content["most"], content["refiner_width"]
    run = VectorFieldRun(path, dict(content["options"]), *sizes, models)
    run.new_net()  # refuses sizes that cannot be
    if run.refiner_width is not None:
        run.new_refiner()
    return run
