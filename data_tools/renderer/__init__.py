"""A renderer in NumPy: labels that are exact, and pictures that one believes."""

from data_tools.renderer.depth import DepthWindow, prepare_surface, render_depth
from data_tools.renderer.labels import Labels, material_images, render_labels
from data_tools.renderer.lights import Ambient, Light
from data_tools.renderer.pictures import render_colour, render_infrared
from data_tools.renderer.prepared import PreparedMesh, prepare
from data_tools.renderer.rasteriser import NEAR, ObjectBuffer, rasterise

__all__ = [
    "NEAR",
    "Ambient",
    "DepthWindow",
    "Labels",
    "Light",
    "ObjectBuffer",
    "PreparedMesh",
    "material_images",
    "prepare",
    "prepare_surface",
    "rasterise",
    "render_colour",
    "render_depth",
    "render_infrared",
    "render_labels",
]
