import numpy as np
import pytest

from data_tools.shapes import Material
from data_tools.shapes.faces import Proportions, head_shape
from data_tools.shapes.hair import BEARDS, HAIR, grow_beard, grow_hair

P = Proportions(1, 1, 1, 1, 1, 1, 1)
HEAD = head_shape(P)
STRANDS = Material((0.2, 0.1, 0.05), pattern="strands")


def vertices(style):
    parts = grow_hair(style, HEAD, P, STRANDS, np.random.default_rng(0))
    return np.vstack([part.vertices for part in parts])


@pytest.mark.parametrize("style", HAIR[1:])
def test_hair_covers_the_crown_and_leaves_the_face(style):
    points = vertices(style)
    outside = points[HEAD(points) > 0.001]
    assert outside[:, 1].max() > 0.11  # over the crown
    behind = outside[outside[:, 2] < -0.15]
    assert len(behind) > 50
    face = (np.abs(outside[:, 0]) < 0.045) & (outside[:, 2] > -0.06) & (outside[:, 1] < 0.025)
    assert not face[outside[:, 1] > -0.12].any()
    forehead = (np.abs(outside[:, 0]) < 0.03) & (outside[:, 2] > -0.05)
    assert outside[forehead, 1].min() > (0.02 if style in ("cap", "beanie") else 0.05)


def test_styles_differ():
    reach = {style: np.ptp(vertices(style), axis=0) for style in HAIR[1:]}
    assert reach["long"][1] > reach["short"][1] + 0.05
    assert reach["curly"][0] > reach["short"][0] + 0.03
    assert reach["bun"][2] > reach["short"][2] + 0.01
    assert reach["cap"][2] > reach["beanie"][2]
    assert grow_hair("bald", HEAD, P, STRANDS, np.random.default_rng(0)) == []


def test_beards():
    assert grow_beard("none", HEAD, P, STRANDS) == grow_beard("stubble", HEAD, P, STRANDS) == []
    (moustache,) = grow_beard("moustache", HEAD, P, STRANDS)
    assert -0.066 < moustache.vertices[:, 1].min() and moustache.vertices[:, 1].max() < -0.043
    (full,) = grow_beard("full", HEAD, P, STRANDS)
    outside = full.vertices[HEAD(full.vertices) > 0.003]
    assert outside[:, 1].min() < -0.11  # under the chin
    assert outside[:, 1].max() < 0.0
    assert np.abs(outside[:, 0]).max() > 0.05  # up to the ears


@pytest.mark.parametrize("style", ["mohawk", "", None, 3])
def test_other_styles(style):
    with pytest.raises(ValueError, match="^style:"):
        grow_hair(style, HEAD, P, STRANDS, np.random.default_rng(0))
    with pytest.raises(ValueError, match="^style:"):
        grow_beard(style, HEAD, P, STRANDS)


def test_names():
    assert len(HAIR) == 8 and len(BEARDS) == 4
