"""Predicted clouds of a dataset on disk, as chapter 4 learns poses from them.

One safetensors file: points in half precision, in the axes of each view's camera and relative to
the predicted translation, and what names the views. Its metadata say which weights made the clouds
and of which images.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import safetensors
import torch
from torch import Tensor

from posecore import weights
from posecore.arrays import fail
from posecore.files import write_bytes
from posecore.methods.infrared.network import CloudNet
from posecore.methods.infrared.triples import Triples

__all__ = ["CloudSet", "made_from", "predict", "read_clouds"]

ABOUT = "clouds"  # the entry of the metadata
REST = {
    "points": (None, 3), "intensities": (None,), "t": (3,), "T_world_cam": (4, 4)
}  # fmt: skip
"""Dimensions of a `CloudSet` behind V; None for N, and none of the others."""
DTYPES = {
    "points": torch.float16, "intensities": torch.float16, "t": torch.float32,
    "scale": torch.float32, "T_world_cam": torch.float64,
}  # fmt: skip
"""Of a `CloudSet`; int64 of the others."""
AT_ONCE = 256  # images that are predicted together


@dataclass(frozen=True, eq=False)
class CloudSet:
    """Clouds of V views, by the order of their dataset.

    Attributes:
        points: (V, N, 3) float16 metres, relative to `t`.
        intensities: (V, N) float16, 0 to 1.
        t: (V, 3) float32 metres, the predicted translation in the camera's frame.
        scale: (V,) float32 of the occupancy.
        net: (V,) int64 which network of the run made it.
        scene_id, image_id, group: (V,) int64 of the views.
        T_world_cam: (V, 4, 4) float64 of their cameras.
        made_from: digests of the networks' weights and of the images, by name.

    Raises:
        ValueError: naming what has another shape or dtype, or is not finite.
    """

    points: Tensor
    intensities: Tensor
    t: Tensor
    scale: Tensor
    net: Tensor
    scene_id: Tensor
    image_id: Tensor
    group: Tensor
    T_world_cam: Tensor
    made_from: dict[str, Any]

    def __post_init__(self) -> None:
        for name, tensor in self._tensors().items():
            if not isinstance(tensor, Tensor):
                fail(name, "a tensor", type(tensor).__name__)
        if self.points.ndim != 3:
            fail("points", "shape (V, N, 3)", f"shape {tuple(self.points.shape)}")
        views, count = self.points.shape[:2]
        for name, tensor in self._tensors().items():
            rest = [count if size is None else size for size in REST.get(name, ())]
            if tensor.shape != (views, *rest):
                fail(name, f"shape {(views, *rest)}", f"shape {tuple(tensor.shape)}")
            if tensor.dtype != (dtype := DTYPES.get(name, torch.int64)):
                fail(name, dtype, tensor.dtype)
            if not tensor.isfinite().all():
                fail(name, "finite numbers", "others")

    def __len__(self) -> int:
        """How many views."""
        return len(self.points)

    def in_world(self) -> Tensor:
        """(V, N, 3) float64 metres, the clouds in the world's frame: `headset`'s is the car."""
        seen = (self.points.float() + self.t[:, None]).double()
        return seen @ self.T_world_cam[:, :3, :3].mT + self.T_world_cam[:, None, :3, 3]

    def write(self, path: str | Path) -> None:
        """Write all of it into one file, which appears when it is whole.

        Raises:
            OSError: if it cannot be written.
        """
        # Copies of their own: the format refuses tensors that share memory.
        kept = {name: tensor.contiguous().clone() for name, tensor in self._tensors().items()}
        about = {"made_from": self.made_from, "digest": weights.digest(kept)}
        # One entry: the format writes several in any order, and equal clouds are equal files.
        write_bytes(Path(path), safetensors.torch.save(kept, {ABOUT: json.dumps(about)}))

    def _tensors(self) -> dict[str, Tensor]:
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "made_from"}


def read_clouds(path: str | Path) -> CloudSet:
    """Read what `CloudSet.write` wrote.

    Raises:
        ValueError: naming the file, if there is none, or it is damaged or something else.
    """
    path = Path(path)
    if not path.is_file():
        fail("path", "a file that `clouds infrared` wrote", f"no {path}")
    try:
        with safetensors.safe_open(path, "pt") as file:
            about = (file.metadata() or {}).get(ABOUT)
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        if about is None:
            raise ValueError("expected clouds, got another kind of file")
        about = json.loads(about)
        if not isinstance(about, dict) or not isinstance(about.get("made_from"), dict):
            raise ValueError("expected what clouds were made from, got something else")
        if weights.digest(tensors) != about["digest"]:
            raise ValueError("other numbers than were written")
        return CloudSet(**tensors, made_from=about["made_from"])
    except (KeyError, ValueError, TypeError, RecursionError, safetensors.SafetensorError) as error:
        words = " ".join(str(error).split())
        raise ValueError(f"{path}: damaged: {words:.200}") from error


def made_from(nets: list[CloudNet], triples: Triples) -> dict[str, Any]:
    """What clouds follow from: digests of the networks, and of the images and their cameras."""
    total = hashlib.sha256()
    for tensor in (triples.images, triples.T_world_cam, triples.views):
        total.update(tensor.contiguous().numpy().tobytes())
    return {
        "weights": [weights.digest(net.state_dict()) for net in nets],
        "images": total.hexdigest()[:16],
    }


@torch.no_grad()
def predict(net: CloudNet, images: Tensor) -> Any:
    """The clouds of many images.

    Args:
        net: in evaluation mode; it stays where it is.
        images: (V, 1, h, w) uint8.

    Returns:
        A `Cloud` of V, on the CPU.
    """
    place = net.low.device
    parts = [net(part.to(place).float() / 255) for part in images.split(AT_ONCE)]
    kind = type(parts[0])
    return kind(*(torch.cat([part[k] for part in parts]).cpu() for k in range(len(parts[0]))))
