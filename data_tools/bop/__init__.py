"""Datasets and results in the formats of the BOP benchmark (Hodan et al., ECCV 2018).

On disk BOP has millimetres; everything that leaves this package is in metres.
"""

from data_tools.bop.category_results import (
    has_categories,
    read_category_results,
    write_category_results,
)
from data_tools.bop.dataset import BopDataset
from data_tools.bop.measuring import Measured, Symmetry, SymmetryCheck, measure_model
from data_tools.bop.meshes import read_mesh
from data_tools.bop.model_writing import to_models_info, to_ply, write_models
from data_tools.bop.models import ModelInfo, ModelInfoWarning, Models
from data_tools.bop.ply import MeshWarning, read_ply
from data_tools.bop.results import read_results, write_results
from data_tools.bop.rotations import RotationWarning
from data_tools.bop.scenes import PlaceholderWarning, UnitWarning
from data_tools.bop.targets import read_targets
from data_tools.bop.writing import write_dataset

__all__ = [
    "BopDataset",
    "Measured",
    "MeshWarning",
    "ModelInfo",
    "ModelInfoWarning",
    "Models",
    "PlaceholderWarning",
    "RotationWarning",
    "Symmetry",
    "SymmetryCheck",
    "UnitWarning",
    "has_categories",
    "measure_model",
    "read_category_results",
    "read_mesh",
    "read_ply",
    "read_results",
    "read_targets",
    "to_models_info",
    "to_ply",
    "write_category_results",
    "write_dataset",
    "write_models",
    "write_results",
]
