"""Networks that a page needs: loaded as they were shipped, or trained here.

What a page ships is declared in `book/experiments/NAME.py`, CHECKPOINTS = {"codec": train_codec},
and trained by `book/make.py train`. The page then says

    codec = load_or_train("05_learnable_rotations", "codec", RotationCodec())
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_choice
from posecore.fingerprint import HOME, code_hash
from posecore.scale import cache_folder, retrain, scale

__all__ = ["load_or_train", "resume_folder"]

Model = TypeVar("Model", bound=nn.Module)


def load_or_train(page: str, key: str, model: Model, *, book: Path = HOME / "book") -> Model:
    """Give a model the weights that the page ships, and say so; train them where that cannot be.

    They are trained at another scale than that of the file, with POSECORE_RETRAIN=1, and where the
    file is absent, damaged or of another model. A file whose code has changed since is loaded: the
    line says that it is stale.

    Args:
        page: a file of `book/experiments`, without its ending: "05_learnable_rotations".
        key: a name in its CHECKPOINTS.
        model: takes the weights.
        book: the folder of the book.

    Returns:
        The same model, in evaluation mode.

    Raises:
        ValueError: if there is no such declaration, or what was trained does not fit the model.
    """
    function = _declared(page, key, book)
    path = book / "checkpoints" / f"{page}.{key}.safetensors"
    reason = _load(path, model)
    if not reason:
        print(f"{key}: loaded from {path.name}{_age(path, function)}")
    else:
        print(f"{key}: {reason}, so it is trained here")
        with torch.random.fork_rng():
            torch.manual_seed(0)  # as `book/make.py train` does
            weights = function()
        try:
            model.load_state_dict(dict(weights))
        except (RuntimeError, TypeError, ValueError) as error:
            fail("model", f"one for the weights of {function.__qualname__}", _first_line(error))
    return model.eval()


def resume_folder(function: Callable[..., Any], *details: object) -> Path:
    """Where a training that was killed goes on, for `fit(..., resume=...)`.

    Its name ends in a hash of details, scale and code, so that a changed page starts anew.

    Args:
        function: the one that trains; its module must be importable by name.
        details: what tells its trainings apart: a seed, the name of a representation.
    """
    function = inspect.unwrap(function)
    words = (scale(), code_hash(function.__module__), *map(str, details))
    digest = hashlib.sha256(json.dumps(words).encode()).hexdigest()[:16]
    name = f"{function.__module__.rpartition('.')[2]}-{function.__qualname__}"
    return cache_folder() / "training" / f"{re.sub('[^A-Za-z0-9_-]+', '_', name)}-{digest}"


def _declared(page: str, key: str, book: Path) -> Callable[[], Mapping[str, Tensor]]:
    require_choice("page", page, sorted(p.stem for p in (book / "experiments").glob("*.py")))
    if str(book.parent) not in sys.path:
        sys.path.append(str(book.parent))  # at the end, where it hides nothing
    module = importlib.import_module(f"{book.name}.experiments.{page}")
    declared = getattr(module, "CHECKPOINTS", {})
    require_choice("key", key, sorted(declared))
    return declared[key]


def _load(path: Path, model: nn.Module) -> str:
    """Load a checkpoint, or say why not."""
    if retrain():
        return "POSECORE_RETRAIN is 1"
    if not path.is_file():
        return f"there is no {path.name}"
    try:
        made_at = _about(path).get("scale")
        weights = safetensors.torch.load(path.read_bytes())
    except (safetensors.SafetensorError, ValueError) as error:
        return f"{path.name} is damaged ({_first_line(error)})"
    if made_at != scale():
        return f"{path.name} was made at {made_at} scale and this is {scale()}"
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        return f"{path.name} is of another model ({_first_line(error)})"
    return ""


def _about(path: Path) -> dict[str, Any]:
    """What `book/make.py train` says in the file of how it was made."""
    with safetensors.safe_open(path, "pt") as file:
        about = json.loads((file.metadata() or {}).get("posecore", "{}"))
    if not isinstance(about, dict):
        raise ValueError("metadata that is no object")
    return about


def _age(path: Path, function: Callable[..., Any]) -> str:
    now = code_hash(inspect.unwrap(function).__module__)
    return "" if _about(path).get("code") == now else "; stale: the code has changed since"


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]
