"""`train cloudpose` and `estimate cloudpose`; what `points_to_pose` shares is tested there."""

import pytest

from posecore.methods.cloudpose.command import CloudPoseRun
from posecore.methods.runs import read_net_run
from tests.methods.poses_commands import (
    check_evaluated,
    check_rows,
    estimate_words,
    estimated,
    train_words,
    trained,
)
from tests.methods.refusing import refused

METHOD = "cloudpose"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory, shared_cache):
    """Nothing in it is to be changed."""
    return trained(METHOD, tmp_path_factory.mktemp("cloudpose"))


def test_poses(run, recording, tmp_path):
    found = read_net_run(run, CloudPoseRun)
    assert (found.kind, found.points, found.object_ids) == ("cloudpose", 64, [1, 2, 3, 4])
    assert not found.load_net().training
    check_rows(estimated(METHOD, run, tmp_path / "poses.csv"))
    check_evaluated(METHOD, run, recording, tmp_path)


def test_what_is_refused(run, tmp_path, capsys):
    refused(capsys, train_words(METHOD, run, "--steps", "4"), "--steps: expected 3 as")
    words = train_words(METHOD, tmp_path / "run", "--clouds", "nowhere")
    refused(capsys, words, "--clouds: expected a file that `clouds infrared` wrote")
    words = estimate_words(METHOD, run, tmp_path / "poses.csv", data="pictures:photos")
    refused(capsys, words, "--data: expected clouds of points, from depth, masks and the poses of")
    words = estimate_words("points_to_pose", run, tmp_path / "poses.csv")
    refused(capsys, words, "method: expected points_to_pose, got cloudpose")
    assert not list(tmp_path.iterdir())
