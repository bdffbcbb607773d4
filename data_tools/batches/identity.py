"""What a dataset is known by in the cache."""

from __future__ import annotations

import hashlib

from data_tools.bop.dataset import BopDataset
from data_tools.storage import code_version
from data_tools.views import Dataset
from data_tools.worlds.world import WorldDataset

__all__ = ["identify"]

# Whose code decides what is kept of a view.
MODULES = (
    "data_tools.batches.decoding",
    "data_tools.batches.files",
    "data_tools.batches.identity",
    "data_tools.views",
)


def identify(dataset: Dataset) -> tuple[str | None, list]:
    """The name of a dataset and all that its views depend on, the code included.

    Returns:
        Name and JSON values; None and nothing for a dataset that nothing identifies.
    """
    if isinstance(dataset, WorldDataset):
        return dataset.world.name, [dataset.store.key, code_version(*MODULES)]
    if isinstance(dataset, BopDataset):
        version = code_version(*MODULES, "data_tools.bop")
        # Targets choose among the images, and among the objects in them.
        chosen = None if dataset._targets is None else sorted(dataset._targets.items())
        targets = chosen and [[*image, sorted((o or {}).items())] for image, o in chosen]
        part = [dataset.split, dataset.sensor, dataset.rotations, targets]
        return "bop", [_contents(dataset), *part, version]
    return None, []


def _contents(dataset: BopDataset) -> str:
    """A hash of the JSON files, and of names and lengths of the others: no image is read."""
    digest = hashlib.sha256()
    folders = [dataset.path / dataset.split, *sorted(dataset.path.glob("models*"))]
    for path in sorted(p for folder in folders for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(dataset.path).as_posix()
        digest.update(f"{name} {path.stat().st_size}\n".encode())
        if path.suffix == ".json":
            digest.update(path.read_bytes())
    return digest.hexdigest()
