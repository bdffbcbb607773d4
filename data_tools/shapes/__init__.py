"""Procedural objects, made from a seed."""

from data_tools.shapes import building, implicit, pieces
from data_tools.shapes.categories import CATEGORIES, make_category
from data_tools.shapes.floors import make_floor
from data_tools.shapes.glasses import GLASSES, make_glasses
from data_tools.shapes.heads import PIVOT, Subject, make_seat, make_subject
from data_tools.shapes.mesh import Material, Mesh
from data_tools.shapes.tabletop import NAMES, make_object

__all__ = [
    "CATEGORIES",
    "GLASSES",
    "NAMES",
    "PIVOT",
    "Material",
    "Mesh",
    "Subject",
    "building",
    "implicit",
    "make_category",
    "make_floor",
    "make_glasses",
    "make_object",
    "make_seat",
    "make_subject",
    "pieces",
]
