"""The losses of RandomizedBins, and of the same trunk with regression.

Source: Berg et al., "Deep Ordinal Regression with Label Diversity", ICPR 2020, Section III.
"""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from posecore.arrays import fail, require_finite
from posecore.methods.random_bins.network import PictureRegression, PoseNumbers, RandomBins

__all__ = ["bins_loss", "nearest_bins", "regression_loss"]


def nearest_bins(values: Tensor, classes: Tensor) -> Tensor:
    """The class nearest to each label.

    Args:
        values: (B, n) labels.
        classes: (n, M, L) the classes' values.

    Returns:
        (B, n, M) int64.

    Raises:
        ValueError: if shapes do not fit.
    """
    if values.ndim != 2 or values.shape[1] != len(classes):
        fail("values", f"shape (B, {len(classes)})", f"shape {tuple(values.shape)}")
    require_finite("values", values)
    return (values[:, :, None, None] - classes).abs().argmin(-1)


def bins_loss(net: RandomBins, said: PoseNumbers, values: Tensor) -> dict[str, Tensor]:
    """Cross-entropy with the nearest class, a mean over sets, numbers and the batch.

    Args:
        net: whose classes they are.
        said: by it.
        values: (B, 6) the true numbers.

    Returns:
        "loss", and its parts "angles" and "position", of which it is the mean.

    Raises:
        ValueError: if `values` has another shape.
    """
    targets = nearest_bins(values, net.classes)
    each = F.cross_entropy(said.logits.flatten(0, 2), targets.flatten(), reduction="none")
    return _parts(each.view(targets.shape).mean(-1))


def regression_loss(net: PictureRegression, said: PoseNumbers, values: Tensor) -> dict[str, Tensor]:
    """Mean absolute error of the six numbers, each in units of half its range.

    Args, returns, raises: as of `bins_loss`.

    Raises:
        ValueError: if `values` have another shape.
    """
    if values.shape != said.values.shape:
        fail("values", f"shape {tuple(said.values.shape)}", f"shape {tuple(values.shape)}")
    return _parts((said.values - values).abs() / ((net.high - net.low) / 2))


def _parts(each: Tensor) -> dict[str, Tensor]:
    angles, position = each[:, :3].mean(), each[:, 3:].mean()
    return {"loss": (angles + position) / 2, "angles": angles, "position": position}
