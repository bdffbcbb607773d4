"""The objective of the field: the loss of a training step, at sampled pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from posecore.methods.vector_field.fields import field_targets
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.models import ObjectModel, require_models

__all__ = ["Objective"]


class Objective:
    """The loss of one step, for `posecore.training.fit`.

    The network computes its vectors at the drawn pixels only: over whole images the losses alone
    would cost more than the network.

    Args:
        models: the objects of the network, in its order.
        loss: which losses, with which weights.
        pixels_per_object: at most so many of each object in each image; None for all.

    Raises:
        ValueError: if the models are none, or have no keypoints or different numbers of them.
    """

    def __init__(
        self,
        models: Sequence[ObjectModel],
        loss: VectorFieldLoss | None = None,
        pixels_per_object: int | None = 256,
    ) -> None:
        models = require_models(models)
        self.loss = VectorFieldLoss() if loss is None else loss
        self.pixels_per_object = pixels_per_object
        self._ids = [model.object_id for model in models]
        self._keypoints = torch.from_numpy(np.stack([model.keypoints for model in models])).float()
        self._symmetries = [
            torch.from_numpy(model.symmetries).float() if model.symmetric else None
            for model in models
        ]

    def __call__(self, net: VectorFieldNet, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch of `RandomCrops` or of a `CropPool`, by name."""
        targets = field_targets(
            batch, self._keypoints, self._ids, self._symmetries, self.pixels_per_object
        )
        features = net.features(batch["rgb"])
        vectors = net.vectors_at(features, targets.image, targets.y, targets.x, targets.object)
        with torch.autocast(features.device.type, enabled=False):
            return self.loss(net.mask(features), vectors, targets, float(batch["done"]))
