"""Weights of networks: the digest by which they are known, and files that hold it with them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

__all__ = ["digest", "fill", "pack", "parse", "require_finite", "unpack"]

DIGEST = "digest"  # its name in what a file says of itself


def digest(weights: Mapping[str, Tensor]) -> str:
    """16 hexadecimal digits of tensors, their names, shapes and dtypes, whatever their order."""
    total = hashlib.sha256()
    for name, tensor in sorted(weights.items()):
        total.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        flat = tensor.detach().cpu().reshape(-1).clone()  # as bytes, bfloat16 too
        total.update(flat.view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:16]


def pack(weights: Mapping[str, Tensor]) -> bytes:
    """The bytes of a safetensors file that holds the digest of its tensors, for `unpack`.

    The same tensors are the same bytes. Tied weights are written once for each of their names.
    """
    # Copies of their own: tied weights share memory, which the format refuses.
    kept = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in weights.items()}
    return safetensors.torch.save(kept, {DIGEST: digest(kept)})


def parse(data: bytes) -> dict[str, Tensor]:
    """The tensors of a safetensors file, whatever they are.

    Raises:
        ValueError: in words of the format, if it is damaged.
    """
    try:
        return safetensors.torch.load(data)
    except safetensors.SafetensorError as error:
        raise ValueError(" ".join(str(error).split())) from error


def unpack(data: bytes) -> dict[str, Tensor]:
    """The tensors of a safetensors file, once they are what a network can have.

    Raises:
        ValueError: saying what is wrong, but not in which file: it is damaged, a tensor is not
            finite, or they have another digest than the file says. Of a file that says none, all
            zero is refused.
    """
    try:
        weights = parse(data)
    except ValueError as error:
        raise ValueError(f"damaged: {error}") from error
    head = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    stated = head.get("__metadata__", {}).get(DIGEST)
    if stated is not None and digest(weights) != stated:
        raise ValueError(f"other weights than were written: digest {digest(weights)}, not {stated}")
    require_finite(weights)
    if stated is None and not any(tensor.any() for tensor in weights.values()):
        raise ValueError("no weights, or only zeros")
    return weights


def require_finite(weights: Mapping[str, Tensor]) -> None:
    """Refuse weights of which one is infinite or no number.

    Raises:
        ValueError: naming the tensor.
    """
    for name, tensor in weights.items():
        if not tensor.isfinite().all():
            raise ValueError(f"expected finite weights, got others in {name}")


def fill(model: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Give a model weights that have its names, shapes and dtypes.

    Raises:
        ValueError: naming the first tensor of another dtype; PyTorch would convert it unsaid.
        RuntimeError: of PyTorch, for other names or shapes.
    """
    for name, tensor in model.state_dict().items():
        if name in weights and weights[name].dtype != tensor.dtype:
            raise ValueError(f"expected {tensor.dtype} in {name}, got {weights[name].dtype}")
    model.load_state_dict(dict(weights))
