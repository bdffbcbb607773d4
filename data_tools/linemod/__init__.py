"""LINEMOD (Hinterstoisser et al., ACCV 2012) as PVNet and DenseFusion lay it out, and own objects.

On disk one of the layouts has millimetres; everything that leaves this package is in metres.
"""

from data_tools.linemod.dataset import LinemodDataset
from data_tools.linemod.models import LinemodModels

__all__ = ["LinemodDataset", "LinemodModels"]
