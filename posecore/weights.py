"""Weights of networks: the digest by which they are known."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import torch
from torch import Tensor

__all__ = ["digest"]


def digest(weights: Mapping[str, Tensor]) -> str:
    """16 hexadecimal digits of tensors, their names, shapes and dtypes, whatever their order."""
    total = hashlib.sha256()
    for name, tensor in sorted(weights.items()):
        total.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        flat = tensor.detach().cpu().reshape(-1).clone()  # as bytes, bfloat16 too
        total.update(flat.view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:16]
