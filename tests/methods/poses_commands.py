"""The words of `train` and `estimate` for methods of one network, and what is true of all."""

import numpy as np

import data_tools
from data_tools.bop import read_results
from posecore.methods.main import main

TRAINING = ["--split", "test", "--scale", "tiny", "--steps", "3", "--batch", "4"]


def train_words(method, out, *more, data="headset"):
    return ["train", method, "--data", data, "--out", str(out), *TRAINING, *more]


def estimate_words(method, run, output, *more, data="headset"):
    words = ["--data", data, "--split", "test", "--output", str(output), *more]
    return ["estimate", method, "--run", str(run), *words]


def trained(method, out, *more):
    """The folder of a run that nothing disturbed."""
    assert main(train_words(method, out, *more)) == 0
    return out


def estimated(method, run, output, *more):
    """The table of what a run says of `headset`'s test views."""
    assert main(estimate_words(method, run, output, *more)) == 0
    return read_results(output)


def check_rows(table):
    """One pose of the glasses for each view, in the frame of its camera: near where they are.

    A network of a few steps knows little of how they are turned, but its answers are about where
    heads are, in front of the camera.
    """
    views = data_tools.open("headset", split="test", scale="tiny")
    assert table.images == [(view.scene_id, view.image_id) for view in views]
    assert table.object_id.tolist() == [view.objects[0].object_id for view in views]
    true = np.array([view.objects[0].t for view in views])
    assert np.median(np.linalg.norm(table.t - true, axis=1)) < 0.35
    assert (table.time > 0).all() and (table.score == 1).all()
    np.testing.assert_allclose(table.R @ table.R.mT, np.tile(np.eye(3), (len(table), 1, 1)),
                               atol=1e-5)  # fmt: skip


def check_evaluated(method, run, recording, tmp_path, *more):
    """Poses of a recording on disk are found by `evaluate`, each of them."""
    output, numbers = tmp_path / "recorded.csv", tmp_path / "numbers.json"
    assert main(estimate_words(method, run, output, *more, data=recording)) == 0
    words = ["evaluate", str(output), recording, "--split", "test", "--json", str(numbers)]
    assert main(words) == 0
    assert numbers.stat().st_size > 0
    assert len(read_results(output)) == 6
