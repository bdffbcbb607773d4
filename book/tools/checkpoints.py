"""Networks that a page needs: loaded as they were shipped, or trained here.

What a chapter ships is declared in its `experiments.py`,

    CHECKPOINTS = {"codec": Training(train_codec)}

and trained by `book/make.py train` into `weights/codec.safetensors`, with `weights/codec.json`
beside it, which says how it was made. The page then says

    codec = load_or_train(experiments, "codec", RotationCodec())
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from book.tools.dependencies import dependencies
from book.tools.ledger import require_named, stale
from posecore import weights
from posecore.arrays import fail, require_choice
from posecore.scale import cache_folder, retrain, scale

__all__ = [
    "SEED",
    "Training",
    "load_or_train",
    "read_about",
    "resume_folder",
    "stale_weights",
    "trained",
    "wrong_weights",
]

Model = TypeVar("Model", bound=nn.Module)
SEED = 0  # of torch's own generator, from which layers take their first weights


class Training(NamedTuple):
    """A network that a chapter ships.

    Attributes:
        function: trains it, and returns its weights by name.
        data: the datasets that it opens, "world/split".
    """

    function: Callable[[], Mapping[str, Tensor]]
    data: tuple[str, ...] = ()


def load_or_train(chapter: ModuleType, key: str, model: Model) -> Model:
    """Give a model the weights that a chapter ships, and say so; train them where that cannot be.

    They are trained at another scale than that of the file, with POSECORE_RETRAIN=1, and where the
    file is absent, damaged, of another model, or holds other weights than were trained, by their
    digest. A file whose code has changed since is loaded: the line says that it is stale.

    Args:
        chapter: the module `book.chNN_name.experiments`, which declares CHECKPOINTS.
        key: a name there.
        model: takes the weights.

    Returns:
        The same model, in evaluation mode.

    Raises:
        ValueError: if there is no such declaration, or what was trained does not fit the model.
    """
    declared = getattr(chapter, "CHECKPOINTS", {})
    require_choice("key", key, sorted(declared))
    function = declared[key].function
    path = Path(chapter.__file__ or "").parent / "weights" / f"{key}.safetensors"
    reason = _load(path, model)
    if not reason:
        changed = stale_weights(path)
        print(f"{key}: loaded from {path.name}" + (f"; stale: {changed[0]}" if changed else ""))
    else:
        print(f"{key}: {reason}, so it is trained here")
        state = trained(declared[key])  # as `book/make.py train` does
        try:
            model.load_state_dict(dict(state))
        except (RuntimeError, TypeError, ValueError) as error:
            fail("model", f"one for the weights of {function.__qualname__}", _first_line(error))
    return model.eval()


def trained(training: Training) -> Mapping[str, Tensor]:
    """The weights, with torch's own random numbers as they are in every training."""
    with torch.random.fork_rng():
        torch.manual_seed(SEED)
        return training.function()


def resume_folder(function: Callable[..., Any], *details: object, data: Iterable[str] = ()) -> Path:
    """Where a training that was killed goes on, for `fit(..., resume=...)`.

    Its name ends in a hash of details, scale, definitions and datasets, so that a changed page, or
    a changed world, starts anew.

    Args:
        function: the one that trains, at the top level of a module that can be imported by name.
        details: what tells its trainings apart: a seed, the name of a representation.
        data: the datasets that it opens, "world/split".
    """
    function = require_named("function", function)
    kept = dependencies(function, data, scale())
    words = (scale(), json.dumps(kept, sort_keys=True), *map(str, details))
    digest = hashlib.sha256(json.dumps(words).encode()).hexdigest()[:16]
    name = f"{function.__module__.rpartition('.')[2]}-{function.__qualname__}"
    return cache_folder() / "training" / f"{re.sub('[^A-Za-z0-9_-]+', '_', name)}-{digest}"


def stale_weights(path: Path) -> tuple[str, ...]:
    """What has changed since a file of weights was trained; nothing if it is fresh.

    Args:
        path: of the weights, with a JSON file of the same name beside them.

    Raises:
        ValueError: if that file is damaged.
    """
    about = read_about(path)
    if not about:
        return (f"no {path.with_suffix('.json').name} says how it was trained",)
    try:
        state = weights.parse(path.read_bytes())
    except (OSError, ValueError) as error:
        return (f"{path.name} cannot be read: {_first_line(error)}",)
    if wrong := wrong_weights(path.name, state, about):
        return (wrong,)
    return stale(about, "trained")


def wrong_weights(name: str, state: Mapping[str, Tensor], about: Mapping[str, Any]) -> str:
    """Why tensors are not those that were trained, by what is kept of them; empty if they are.

    Args:
        name: of their file, which the words begin with.
        state: the tensors; their digest knows every bit, name, shape and dtype.
        about: of them, from `read_about`.
    """
    if weights.digest(state) != about["digest"]:
        return f"{name} holds other weights than were trained"
    try:
        weights.require_finite(state)
    except ValueError as error:
        return f"{name}: {error}"
    return ""


def read_about(path: Path) -> dict[str, Any]:
    """How a file of weights was made; empty where nothing says so.

    Raises:
        ValueError: if the file that says so is damaged.
    """
    file = path.with_suffix(".json")
    if not file.is_file():
        return {}
    try:
        about = json.loads(file.read_bytes())
        _ = (about["module"], about["function"], about["digest"], about["scale"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file.name} is damaged: {error!r}") from error
    return about


def _load(path: Path, model: nn.Module) -> str:
    """Load a checkpoint, or say why not."""
    if retrain():
        return "POSECORE_RETRAIN is 1"
    if not path.is_file():
        return f"there is no {path.name}"
    try:
        about = read_about(path)
    except ValueError as error:
        return _first_line(error)
    if not about:
        return f"no {path.with_suffix('.json').name} says how {path.name} was made"
    try:
        state = weights.parse(path.read_bytes())
    except ValueError as error:
        return f"{path.name} is damaged ({_first_line(error)})"
    if about["scale"] != scale():
        return f"{path.name} was made at {about['scale']} scale and this is {scale()}"
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        return f"{path.name} is of another model ({_first_line(error)})"
    return wrong_weights(path.name, state, about)


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]
