"""What a training runs on: the device, its fastest safe arithmetic, and processes that share it."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from posecore.arrays import fail, require_choice

__all__ = [
    "PRECISIONS",
    "Processes",
    "choose_device",
    "convolves",
    "each_tensor",
    "launched",
    "uses_bfloat16",
]

PRECISIONS = ("auto", "float32", "bfloat16")


def choose_device(name: str) -> torch.device:
    """`"auto"` is a GPU where there is one; of several, each process of torchrun takes its own.

    Raises:
        ValueError: if PyTorch knows or has no such device, or it is "meta", which holds no numbers.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and "LOCAL_RANK" in os.environ:
        name = f"cuda:{os.environ['LOCAL_RANK']}"
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, TypeError, AssertionError, ImportError) as error:
        fail("device", "'auto' or a device of this machine", f"{name!r}: {error}".splitlines()[0])
    if device.type == "meta":
        fail("device", "'auto' or a device that computes", repr(name))
    if device.type == "cuda":
        torch.cuda.set_device(device)
    return device


def launched() -> tuple[int, int]:
    """The place of this process among those of torchrun, and how many they are; (0, 1) for one.

    Raises:
        ValueError: naming the variable of the environment, if `WORLD_SIZE` is no number of
            processes, or `RANK` is none of their places. Of several, a place must be given.
    """
    count = _variable("WORLD_SIZE", 1, "an integer of at least 1", range(1, sys.maxsize))
    below = f"an integer from 0 to {count - 1}, below WORLD_SIZE"
    return _variable("RANK", 0 if count == 1 else None, below, range(count)), count


def _variable(name: str, default: int | None, words: str, allowed: range) -> int:
    text = os.environ.get(name)
    if text is None and default is not None:
        return default
    try:
        if (value := int(text or "")) in allowed:
            return value
    except ValueError:
        pass
    fail(name, f"{words}; torchrun sets both", "nothing" if text is None else repr(text))


def convolves(model: nn.Module) -> bool:
    """Whether it convolves images."""
    return any(isinstance(module, nn.Conv2d | nn.ConvTranspose2d) for module in model.modules())


def uses_bfloat16(precision: str, device: torch.device, model: nn.Module) -> bool:
    """Whether to compute with 8 bits of precision where that is usual; weights keep float32.

    `"auto"` does so for networks that convolve images, on hardware that knows these numbers;
    elsewhere they are slower than float32. Small nets on points and codes would gain as much, but
    their outputs are the answer itself, which three digits are not enough for.

    Raises:
        ValueError: if `precision` is none of `PRECISIONS`.
    """
    require_choice("precision", precision, PRECISIONS)
    if precision != "auto":
        return precision == "bfloat16"
    if device.type == "cuda":
        native = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        features = torch.cpu.get_capabilities() if device.type == "cpu" else {}
        native = bool(features.get("avx512_bf16") or features.get("amx_bf16"))
    return native and convolves(model)


def each_tensor(batch: Any, function: Callable[[Tensor], Tensor]) -> Any:
    """A batch like this one, its tensors replaced; anything that is no tensor stays."""
    if isinstance(batch, Tensor):
        return function(batch)
    if isinstance(batch, Mapping):
        return {name: each_tensor(value, function) for name, value in batch.items()}
    if isinstance(batch, list | tuple):
        values = [each_tensor(value, function) for value in batch]
        return type(batch)(*values) if hasattr(batch, "_fields") else type(batch)(values)
    return batch


@dataclass(frozen=True)
class Processes:
    """The processes that train one network together; one alone, unless torchrun started several."""

    rank: int = 0
    count: int = 1

    @classmethod
    def joined(cls, device: torch.device) -> Processes:
        """Let the processes of torchrun talk to each other, from now to their end.

        Raises:
            ValueError: as `launched`.
        """
        if not dist.is_initialized() and launched()[1] > 1:
            # Once: a second group may find the addresses of the first and wait for ever.
            dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
            atexit.register(dist.destroy_process_group)
        if not dist.is_initialized():
            return cls()
        dist.barrier()  # whoever is still writing checkpoints of the run before
        return cls(dist.get_rank(), dist.get_world_size())

    def share(self, batch: Any) -> Any:
        """This process's part of a batch: every tensor's first dimension is divided.

        Raises:
            ValueError: if the parts would not be equally large.
        """
        if self.count == 1:
            return batch
        sizes = set()
        each_tensor(batch, lambda tensor: sizes.add(len(tensor)) if tensor.ndim else None)
        if len(sizes) != 1 or max(sizes) % self.count:
            fail("batches", f"tensors of one length that {self.count} divides", sorted(sizes))
        part = max(sizes) // self.count
        mine = slice(self.rank * part, (self.rank + 1) * part)
        return each_tensor(batch, lambda tensor: tensor[mine] if tensor.ndim else tensor)

    def mean(self, values: Tensor) -> Tensor:
        """The mean over all processes."""
        if self.count > 1:
            dist.all_reduce(values)
        return values / self.count
