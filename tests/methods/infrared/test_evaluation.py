"""How good clouds are: on shapes of which one knows it."""

import pytest
import torch

from posecore.methods.infrared.evaluation import first_met, overlap, surface_distances


def test_overlap_of_squares():
    masks = torch.zeros(2, 8, 8, dtype=torch.bool)
    masks[:, 2:6, 2:6] = True
    seen = torch.zeros(2, 8, 8)
    seen[0, 2:6, 4:8] = 0.6
    seen[1, 2:6, 2:6] = 0.6
    assert overlap(seen, masks).tolist() == pytest.approx([8 / 24, 1])
    assert overlap(seen, masks, 0.7).tolist() == [0, 0]
    assert overlap(seen[None], masks[None]).shape == (1, 2)
    assert overlap(seen[0], masks[0]).item() == pytest.approx(1 / 3)
    nothing = torch.zeros(2, 8, 8)
    assert overlap(nothing, nothing.bool()).tolist() == [1, 1]
    assert overlap(nothing, masks).tolist() == overlap(seen, nothing.bool()).tolist() == [0, 0]


def test_silhouettes_are_brought_to_the_size_of_the_masks():
    masks = torch.zeros(3, 8, 8, dtype=torch.bool)
    masks[:, 2:6, 2:6] = True
    small = torch.zeros(3, 4, 4)
    small[:, 1:3, 1:3] = 1
    assert overlap(small, masks).tolist() == [1] * 3
    assert overlap(small, masks, 0.6).tolist() == pytest.approx([12 / 16] * 3)  # without corners


@pytest.mark.parametrize(
    ("name", "masks", "threshold"),
    [
        ("masks", torch.zeros(3, 8, 8, dtype=torch.bool), 0.5),
        ("masks", torch.zeros(2, 8, 8), 0.5),
        ("threshold", torch.zeros(2, 8, 8, dtype=torch.bool), 1.5),
    ],
)
def test_overlaps_that_cannot_be(name, masks, threshold):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        overlap(torch.zeros(2, 8, 8), masks, threshold)


def test_a_point_behind_another_is_not_met():
    voxels = torch.tensor([[5.0, 5, 2], [5.5, 5.5, 4.9], [5.5, 5.5, 5.1], [7.1, 5, 9], [5, 5, 30]])
    assert first_met(voxels).tolist() == [True, True, False, True, False]
    assert first_met(voxels, radius=2.0).tolist() == [True, True, False, False, False]
    assert first_met(voxels, behind=2.8).tolist() == [True, False, False, True, False]
    assert first_met(voxels.expand(2, 5, 3)).tolist() == [first_met(voxels).tolist()] * 2


def test_of_two_walls_the_first_is_met():
    wall = torch.cartesian_prod(torch.arange(8.0), torch.arange(8.0), torch.tensor([3.0, 12]))
    assert torch.equal(first_met(wall), wall[:, 2] == 3)


def test_distances_both_ways():
    surface = torch.tensor([[0.0, 0, 1], [1, 0, 1]])
    cloud = torch.tensor([[0.0, 0, 1.5], [1, 2, 1], [0, 0, 9]])
    there, back = surface_distances(cloud, torch.tensor([True, True, False]), surface)
    # (0, 0, 1) is 0.5 from the first point; (1, 0, 1) is sqrt(1.25) from it and 2 from the second.
    assert there == pytest.approx((0.5 + 1.25**0.5) / 2)
    assert back == pytest.approx((0.5 + 2) / 2)
    assert surface_distances(surface, torch.ones(2, dtype=torch.bool), surface) == (0, 0)


def test_distances_of_nothing():
    points, none = torch.zeros(2, 3), torch.zeros(2, dtype=torch.bool)
    with pytest.raises(ValueError, match="^surface"):
        surface_distances(points, ~none, points[:0])
    with pytest.raises(ValueError, match="^visible"):
        surface_distances(points, none, points)


def test_what_is_no_number_is_not_measured():
    """It covers nothing and hides nothing, and would count as a score."""
    with pytest.raises(ValueError, match="^silhouettes: expected finite"):
        overlap(torch.full((2, 3, 4), torch.nan), torch.ones(2, 3, 4, dtype=torch.bool))
    with pytest.raises(ValueError, match="^voxels: expected finite"):
        first_met(torch.full((4, 3), torch.nan))
