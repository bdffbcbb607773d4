"""What is read of a split without its views."""

import numpy as np
import pytest

from data_tools.bop import BopDataset
from data_tools.bop.pieces import has_depth, read_depth_image, visible_fractions


def test_visible_fractions_go_with_the_poses(tree):
    dataset = BopDataset(tree.path, "test")
    shares = visible_fractions(dataset)
    assert shares.tolist() == [0.75, 0.0, 0.75, 0.75]
    assert len(shares) == len(dataset.ground_truth())
    tree.json["test_targets"] = [{"scene_id": 1, "im_id": 4, "obj_id": 2, "inst_count": 1}]
    tree.save()
    chosen = BopDataset(tree.path, "test", targets="test_targets.json")
    assert visible_fractions(chosen).tolist() == [0.75]
    assert visible_fractions(chosen, targets_only=False).tolist() == [0.75, 0.0, 0.75]
    tree.remove("test/000001/scene_gt_info.json")
    assert visible_fractions(BopDataset(tree.path, "test")) is None


def test_one_depth_image(tree):
    """One scene has depth images, the other has none."""
    dataset = BopDataset(tree.path, "test")
    assert not has_depth(dataset)
    np.testing.assert_array_equal(read_depth_image(dataset, 1, 4), dataset[0].depth)
    assert read_depth_image(dataset, 12, 0) is None
    with pytest.raises(ValueError, match="image_id"):
        read_depth_image(dataset, 1, 5)
    tree.image(12, "depth", 0, np.full((12, 16), 7, np.uint16))
    tree.json["test/000012/scene_camera"]["0"]["depth_scale"] = 2.0
    tree.save()
    dataset = BopDataset(tree.path, "test")
    assert has_depth(dataset)
    assert read_depth_image(dataset, 12, 0).max() == np.float32(0.014)
    tree.remove("test/000012/depth/000000.png")
    with pytest.raises(FileNotFoundError, match="000000"):
        read_depth_image(dataset, 12, 0)
