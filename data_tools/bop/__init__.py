"""Datasets and results in the formats of the BOP benchmark (Hodan et al., ECCV 2018).

On disk BOP has millimetres; everything that leaves this package is in metres.
"""

from data_tools.bop.dataset import BopDataset
from data_tools.bop.measuring import Symmetry, measure_model
from data_tools.bop.models import ModelInfo, ModelInfoWarning, Models
from data_tools.bop.results import read_results, write_results
from data_tools.bop.rotations import RotationWarning
from data_tools.bop.writing import write_dataset

__all__ = [
    "BopDataset",
    "ModelInfo",
    "ModelInfoWarning",
    "Models",
    "RotationWarning",
    "Symmetry",
    "measure_model",
    "read_results",
    "write_dataset",
    "write_results",
]
