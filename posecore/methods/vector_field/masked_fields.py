"""Vector fields where they count: at the pixels of each object's mask, and nowhere else."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from torch import Tensor

from posecore.arrays import fail, require_integer
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.training.machine import uses_bfloat16

__all__ = ["MaskedFields", "predict_fields"]


class MaskedFields:
    """The fields of S objects, each at the pixels of its own mask.

    An entry is one object in one image; entries are in order of their image, then of their object.
    A mask is a small part of an image, so the fields of thousands of objects can be kept, and asked
    at any pixels (`at`).

    Attributes:
        image, object: (S,) int64, which image and which object of the network each entry is.
        counts: (S,) int64 pixels in its mask.
        confidence: (S,) mean probability of these pixels.

    Args:
        image, y, x, object: (P,) int64 of each pixel in a mask, in any order, as `FieldTargets` has
            them; no pixel twice for an object.
        vectors: (P, K, 2) what the field says there.
        probability: (P,) of being the object's; 1 by default.
        min_pixels: objects with fewer in an image are left out.

    Raises:
        ValueError: if shapes do not fit, or a number is negative.
    """

    def __init__(
        self,
        image: Tensor,
        y: Tensor,
        x: Tensor,
        object: Tensor,
        vectors: Tensor,
        probability: Tensor | None = None,
        min_pixels: int = 1,
    ) -> None:
        min_pixels = require_integer("min_pixels", min_pixels, 1)
        if vectors.ndim != 3 or vectors.shape[-1] != 2:
            fail("vectors", "shape (P, K, 2)", f"shape {tuple(vectors.shape)}")
        if probability is None:
            probability = vectors.new_ones(len(vectors))
        named = {"image": image, "y": y, "x": x, "object": object, "probability": probability}
        for name, value in named.items():
            if value.shape != vectors.shape[:1]:
                expected = f"shape ({len(vectors)},) as vectors have it"
                fail(name, expected, f"shape {tuple(value.shape)}")
            if len(value) and value.amin() < 0:
                fail(name, "no number below 0", value.amin().item())

        highest = int(object.max()) + 1 if len(object) else 1
        key, entry, counts = (image * highest + object).unique(
            return_inverse=True, return_counts=True
        )
        large = counts >= min_pixels
        kept = large[entry].nonzero()[:, 0]
        kept = kept[entry[kept].argsort(stable=True)]
        self._entry = (large.cumsum(0) - 1)[entry[kept]]  # (P',) ascending
        self._pixels = torch.stack([x, y], -1)[kept]
        self._vectors = vectors[kept]
        self.image, self.object = key[large] // highest, key[large] % highest
        self.counts = counts[large]
        total = probability.new_zeros(len(self)).index_add(0, self._entry, probability[kept])
        self.confidence = total / self.counts
        self._end = self.counts.cumsum(0)
        self._make_table()

    def __len__(self) -> int:
        """How many entries."""
        return len(self.image)

    def _make_table(self) -> None:
        """For each entry its box, and for each pixel of the box the row of that pixel, or -1."""
        entry, pixels = self._entry, self._pixels
        where, zeros = entry[:, None].expand(-1, 2), pixels.new_zeros(len(self), 2)
        self._low = zeros.scatter_reduce(0, where, pixels, "amin", include_self=False)
        high = zeros.scatter_reduce(0, where, pixels, "amax", include_self=False)
        self._size = high - self._low + 1
        area = self._size.prod(-1)
        self._first = area.cumsum(0) - area
        x, y = (pixels - self._low[entry]).unbind(-1)
        place = self._first[entry] + y * self._size[entry, 0] + x
        self._row = place.new_full((int(area.sum()),), -1)
        self._row[place] = torch.arange(len(place), device=place.device)

    def to(self, device: torch.device | str) -> MaskedFields:
        """The same fields on a device."""
        moved = copy.copy(self)
        vars(moved).update({name: value.to(device) for name, value in vars(self).items()})
        return moved

    def of(self, entry: int) -> tuple[Tensor, Tensor]:
        """The pixels (P', 2) in the mask of one entry, x and y, and their vectors (P', K, 2)."""
        end = int(self._end[entry])
        rows = slice(end - int(self.counts[entry]), end)
        return self._pixels[rows], self._vectors[rows]

    def at(self, entry: Tensor, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """What the field says at some pixels.

        Args:
            entry: (B,) int64.
            pixels: (B, N, 2) x and y, rounded here to the nearest pixel; infinite is outside.

        Returns:
            (B, N, K, 2) vectors, zero outside of the mask; and (B, N) bool, whether inside; both on
            the device of `pixels`.
        """
        row, inside = self._rows(entry, pixels)
        vectors = self._vectors[row].to(pixels)
        inside = inside.to(pixels.device)
        return vectors.masked_fill(~inside[..., None, None], 0), inside

    def contains(self, entry: Tensor, pixels: Tensor) -> Tensor:
        """Only whether inside: (B, N) bool; arguments as of `at`."""
        return self._rows(entry, pixels)[1].to(pixels.device)

    def _rows(self, entry: Tensor, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N) rows of the pixels, any one outside of the mask; and whether inside."""
        entry, pixels = entry.to(self._low.device), pixels.to(self._low.device)
        low, size = self._low[entry][:, None], self._size[entry][:, None]  # (B, 1, 2)
        offset = pixels.round() - low  # not yet integers, which cannot be infinite
        in_box = ((offset >= 0) & (offset < size)).all(-1)  # (B, N)
        x, y = offset.masked_fill(~in_box[..., None], 0).long().unbind(-1)
        row = self._row[self._first[entry][:, None] + y * size[..., 0] + x]
        return row.clamp(min=0), in_box & (row >= 0)

    @classmethod
    def joined(cls, parts: Sequence[MaskedFields], precision: torch.dtype) -> MaskedFields:
        """Several as one; images are numbered on from one to the next.

        Args:
            parts: at least one.
            precision: of the vectors; half of it is good to a thirtieth of a degree.

        Raises:
            ValueError: if there are no parts.
        """
        if not parts:
            fail("parts", "at least one", "none")
        columns, first = [], 0
        for part in parts:
            x, y = part._pixels.unbind(-1)
            entry = part._entry
            image = first + part.image[entry]
            vectors, sure = part._vectors.to(precision), part.confidence[entry]
            columns.append((image, y, x, part.object[entry], vectors, sure))
            first += int(part.image.max()) + 1 if len(part) else 0
        return cls(*(torch.cat(column) for column in zip(*columns, strict=True)))


@torch.no_grad()
def predict_fields(
    net: VectorFieldNet, images: Tensor, min_pixels: int = 20, precision: str = "auto"
) -> MaskedFields:
    """Predict the masks and vector fields of images; vectors at the pixels of the masks only.

    A pixel is of the class of largest logit.

    Args:
        net: in evaluation mode, as `fit` leaves it; it computes where it is.
        images: (B, 3, H, W) RGB, 0 to 1.
        min_pixels: masks with fewer are no entry.
        precision: "float32", "bfloat16", or "auto" for what `fit` would choose.

    Raises:
        ValueError: for images or a precision that cannot be.
    """
    device = next(net.parameters()).device
    half = uses_bfloat16(precision, device, net)
    images = images.to(device, memory_format=torch.channels_last)
    with torch.autocast(device.type, torch.bfloat16, enabled=half):
        features = net.features(images)
    logits = net.mask(features)  # (B, 1 + O, H, W)
    label = logits.argmax(1)
    image, y, x = label.nonzero(as_tuple=True)
    object = label[image, y, x] - 1
    return MaskedFields(
        image,
        y,
        x,
        object,
        net.vectors_at(features, image, y, x, object),
        logits.permute(0, 2, 3, 1)[image, y, x].softmax(-1).amax(-1),
        min_pixels,
    )
