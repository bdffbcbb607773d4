"""Both roads with true words, with a little noise, with wrong points; where nothing can be told."""

import pytest
import torch

from posecore.methods.invariant_gcn.poses import ROADS, canonical_pose, estimated_pose
from posecore.metrics import axis_error, rotation_error
from tests.methods.invariant_gcn.small import batch, network, say
from tests.methods.invariant_gcn.test_total_loss import true_words


@pytest.mark.parametrize("road", ROADS)
def test_true_words_give_the_pose_and_the_size(road):
    given = batch()
    found = estimated_pose(true_words(given), given["points"], road)
    assert found.found.all()
    for name in ("R", "t", "size"):
        torch.testing.assert_close(getattr(found, name), given[name], rtol=1e-4, atol=1e-5)


def test_points_that_are_not_sure_or_do_not_agree():
    given = batch()
    said = true_words(given)
    canonical, sure = said.canonical.clone(), said.canonical_confidence.clone()
    canonical[:, :12] += torch.tensor([0.3, -0.2, 0.2])
    wrong = said._replace(canonical=canonical)
    sure[:, :12] = -100
    doubting = wrong._replace(canonical_confidence=sure)
    errors = {
        name: rotation_error(canonical_pose(words, given["points"], road).R, given["R"]).max()
        for name, words, road in (
            ("plain", wrong, "plain"), ("weighted", doubting, "weighted"),
            ("ransac", wrong, "ransac"),
        )
    }  # fmt: skip
    assert errors["plain"] > 0.05
    assert errors["weighted"] < 1e-3
    assert errors["ransac"] < 1e-3


def test_where_coordinates_collapse_nothing_is_found():
    given = batch()
    said = true_words(given)
    canonical = said.canonical.clone()
    canonical[1] = canonical[1, :1]
    for road in ROADS[1:]:
        found = canonical_pose(said._replace(canonical=canonical), given["points"], road)
        assert found.found.tolist() == [True, False, True]
        assert torch.equal(found.R[1], torch.eye(3)) and not found.t[1].any()
        torch.testing.assert_close(found.R[[0, 2]], given["R"][[0, 2]], rtol=1e-4, atol=1e-4)


def test_of_symmetric_things_y_alone_counts():
    given = batch()
    said = true_words(given)
    said = said._replace(x=said.x + 0.5 * said.y, y_confidence=torch.full((3,), 0.1))
    some = torch.tensor([True, False, False])
    found = estimated_pose(said, given["points"], "direct", some)
    off = axis_error(found.R, given["R"], torch.tensor([0.0, 1, 0]))
    assert off[0] < 1e-3 < 0.1 < off[1:].min()


def test_sizes_are_never_none():
    given = batch()
    said = true_words(given)._replace(size=-torch.ones(3, 3), proportions=-torch.ones(3, 3))
    for road in ROADS:
        assert (estimated_pose(said, given["points"], road).size >= 1e-3).all()


def test_what_an_untrained_network_says_is_a_pose():
    given = batch()
    said = say(network(), given)
    for road in ROADS:
        found = estimated_pose(said, given["points"], road)
        assert all(part.isfinite().all() for part in found)
        torch.testing.assert_close(found.R.mT @ found.R, torch.eye(3).repeat(3, 1, 1))


def test_roads_that_are_not_there():
    given = batch()
    with pytest.raises(ValueError, match="^road: expected one of 'direct', 'plain'"):
        estimated_pose(true_words(given), given["points"], "kabsch")
    with pytest.raises(ValueError, match="^road: expected one of a branch .*, got direct"):
        estimated_pose(say(network(branches=("canonical",)), given), given["points"], "direct")
    with pytest.raises(ValueError, match="^road: expected one of a branch .*, got plain"):
        estimated_pose(say(network(branches=("axes",)), given), given["points"], "plain")
