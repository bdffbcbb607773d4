"""`train invariant_gcn` and `estimate invariant_gcn` on the world of categories."""

import numpy as np
import pytest

import data_tools
from data_tools.bop import read_results
from posecore.methods.invariant_gcn.runs import InvariantGCNRun
from posecore.methods.main import main
from posecore.methods.runs import read_net_run
from tests.methods.refusing import refused

METHOD = "invariant_gcn"
DATA = ["--data", "categories"]

pytestmark = pytest.mark.slow


def train_words(out, *more, steps="3"):
    words = ["--split", "synthetic", "--out", str(out), "--scale", "tiny", "--batch", "4"]
    return ["train", METHOD, *DATA, *words, "--steps", steps, *more]


def estimate_words(run, output, *more):
    words = ["--run", str(run), "--split", "shifted", "--output", str(output)]
    return ["estimate", METHOD, *DATA, *words, *more]


@pytest.fixture(scope="module")
def run(tmp_path_factory, shared_cache):
    """Of the paper's network. Nothing in it is to be changed."""
    out = tmp_path_factory.mktemp("printed")
    assert main(train_words(out)) == 0
    return out


def check_rows(path):
    """A pose of everything in the split, of things that were not there in training."""
    table = read_results(path)
    views = data_tools.open("categories", split="shifted", scale="tiny")
    assert len(table) == sum(len(view.objects) for view in views)
    true = {(v.image_id, o.object_id): o.t for v in views for o in v.objects}
    rows = zip(table.image_id.tolist(), table.object_id.tolist(), strict=True)
    off = [np.linalg.norm(t - true[row]) for row, t in zip(rows, table.t, strict=True)]
    return np.median(off)


def test_poses_of_things_never_seen(run, tmp_path):
    found = read_net_run(run, InvariantGCNRun)
    assert found.categories == ["bottle", "bowl", "camera", "can", "laptop", "mug"]
    assert found.revolution == ["bottle", "bowl", "can"] and found.points == 64
    assert not found.load_net().training
    output = tmp_path / "poses.csv"
    assert main(estimate_words(run, output)) == 0
    assert check_rows(output) < 0.15  # where the points are
    assert main(estimate_words(run, output, "--road", "ransac")) in (0, None)


def test_of_invariants(tmp_path):
    run, output = tmp_path / "run", tmp_path / "poses.csv"
    assert main(train_words(run, "--kind", "invariant")) == 0
    assert main(estimate_words(run, output)) == 0
    assert len(read_results(output))


def test_what_is_refused(run, tmp_path, capsys):
    refused(capsys, train_words(run, steps="4"), "--steps: expected 3 as")
    refused(capsys, train_words(run, "--kind", "a1"), "--kind: expected printed as")
    out = str(tmp_path / "new")
    words = ["train", METHOD, "--data", "tabletop", "--split", "easy", "--out", out]
    message = "--data: tabletop: data: expected objects with category and size"
    refused(capsys, [*words, "--scale", "tiny"], message)
    output = tmp_path / "poses.csv"
    words = estimate_words(run, output)
    refused(capsys, ["estimate", "cloudpose", *words[2:]], "method: expected cloudpose")
    assert not output.exists()
