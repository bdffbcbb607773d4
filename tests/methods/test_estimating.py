"""The loop that estimates for every method, with an estimator made up."""

import argparse
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch

from data_tools.bop import read_results
from posecore.methods import estimating
from posecore.methods.estimating import (
    PlainEstimate,
    add_parser,
    estimate,
    estimate_views,
    known_object,
)


class Found(NamedTuple):
    object_id: int
    R: np.ndarray
    t: np.ndarray
    score: float


class Counting:
    """Finds as many poses of object 4 as it has seen images before."""

    def __init__(self):
        self.seen = []

    def estimate(self, images, K):
        self.seen.append((images, K))
        count = len(self.seen) - 1
        return [Found(4, np.eye(3), np.array([0, 0, K[0, 0]]), n / 10) for n in range(count)]


class Run:
    def __init__(self):
        self.options, self.object_ids = {"scale": "tiny"}, [4, 99]


@pytest.fixture
def clock(monkeypatch):
    """One on which every image takes 2 seconds."""
    ticks = iter(range(0, 1000, 2))
    monkeypatch.setattr("time.perf_counter", lambda: next(ticks))


def test_what_an_estimator_is_given(three):
    counting = Counting()
    estimate_views(counting, three, "three")
    for (image, K), view in zip(counting.seen, three, strict=True):
        assert image.shape == (1, 3, 24, 32) and image.dtype == torch.float32
        np.testing.assert_array_equal(image[0].permute(1, 2, 0) * 255, view.rgb)
        np.testing.assert_array_equal(K, view.K)


def test_what_becomes_of_its_poses(three, clock):
    table, seconds = estimate_views(Counting(), three, "three")
    assert seconds == [2, 2, 2]
    assert table.images == [(2, 1), (2, 2), (2, 2)]
    assert table.object_id.tolist() == [4, 4, 4]
    assert table.t.tolist() == [[0, 0, 61], [0, 0, 62], [0, 0, 62]]
    assert table.score.tolist() == [0, 0, 0.1]
    assert table.time.tolist() == [2, 2, 2]
    np.testing.assert_array_equal(table.R, [np.eye(3)] * 3)


def test_no_poses_are_a_table_too(three):
    three.object_ids = ()

    class Blind:
        def estimate(self, images, K):
            return []

    table, seconds = estimate_views(Blind(), three, "three")
    assert len(table) == 0 and len(seconds) == 3
    assert table.R.shape == (0, 3, 3) and table.t.shape == (0, 3)


def test_views_without_colours_are_refused(three):
    three.kind = "ir"
    with pytest.raises(ValueError, match="^--data: expected data with colour images.*in three"):
        estimate_views(Counting(), three, "three")


def parsed(*words):
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers(), "made_up", print, summary="one", description="Some.")
    return parser.parse_args(["made_up", "--run", "RUN", "--data", "bop:three", *words])


def test_the_command(three, tmp_path, monkeypatch, capsys, clock):
    output, opened, made = tmp_path / "out.csv", [], []

    def open_three(*arguments, **options):
        opened.append((*arguments, options))
        return three

    def new_estimator(run, options, device):
        made.append((run, options, device))
        return Counting()

    monkeypatch.setattr(estimating, "open_source", open_three)
    words = ["--output", str(output), "--targets", "t.json", "--split", "test", "--device", "cpu"]
    options, run = parsed(*words), Run()
    assert options.command is print  # what `add_parser` was given
    estimate(options, lambda path: run if path == "RUN" else None, new_estimator)
    assert opened == [("bop:three", "test", "tiny", {"targets": "t.json"})]
    assert made == [(run, options, torch.device("cpu"))]
    assert capsys.readouterr().out == f"{output}: 3 poses in 3 images, 2000 ms an image (median)\n"
    assert read_results(output).t.tolist() == [[0, 0, 61], [0, 0, 62], [0, 0, 62]]


def refuse(*_):
    raise AssertionError("came too far")


def test_what_is_refused_before_the_work(three, tmp_path, monkeypatch):
    monkeypatch.setattr(estimating, "open_source", lambda *_, **__: three)
    there = ["--output", str(tmp_path / "out.csv")]
    with pytest.raises(ValueError, match="^--output: expected a file in a folder that exists"):
        estimate(parsed("--output", str(tmp_path / "no" / "out.csv")), refuse, refuse)
    options = parsed(*there, "--targets", "t.json")
    options.data = "tabletop"
    with pytest.raises(ValueError, match="^--targets: expected nothing, as the data are no bop:"):
        estimate(options, lambda _: Run(), refuse)
    with pytest.raises(ValueError, match="^device: "):
        estimate(parsed(*there, "--device", "moon"), lambda _: Run(), refuse)
    three.object_ids = (7,)
    with pytest.raises(ValueError, match=r"^--data: .*one of the run's objects \[4, 99\], got \[7"):
        estimate(parsed(*there), lambda _: Run(), refuse)
    assert list(tmp_path.iterdir()) == []


def test_no_input_is_written_over(three, tmp_path, monkeypatch):
    monkeypatch.setattr(estimating, "open_source", lambda *_, **__: three)
    (folder := tmp_path / "run").mkdir()
    for file in ("run.json", "net.safetensors"):
        (folder / file).write_text("kept")
        options = parsed("--output", str(folder / file))
        options.run = str(folder)
        with pytest.raises(ValueError, match="^--output: expected a file that the command does"):
            estimate(options, refuse, refuse)
        assert (folder / file).read_text() == "kept"


class Brightness:
    """An estimator that takes something else than colours: how bright the infrared image is."""

    def look(self, view):
        return view.ir.mean(), known_object(view, [4])

    def estimate(self, bright, object_id):
        return [PlainEstimate(object_id, np.eye(3), np.array([0, 0, bright]))]


def test_an_estimator_that_looks_for_itself(three, clock):
    three.kind = "ir"
    table, seconds = estimate_views(Brightness(), three, "three")
    assert seconds == [2, 2, 2] and table.t[:, 2].tolist() == [0, 10, 20]
    assert table.object_id.tolist() == [4, 4, 4] and table.score.tolist() == [1, 1, 1]


def test_which_object_a_view_shows(three):
    view = three[0]
    assert known_object(view, [7, 9]) == 4
    bare = replace(view, objects=[])
    assert known_object(bare, [7]) == 7
    with pytest.raises(ValueError, match=r"^--data: expected data that say which .*\[7, 9\]"):
        known_object(bare, [7, 9])


def test_clouds_that_are_read_are_not_written_over(three, tmp_path):
    options = parsed("--output", str(tmp_path / "clouds"))
    options.clouds = options.output
    with pytest.raises(ValueError, match="^--output: expected a file that the command does not"):
        estimate(options, refuse, refuse)


def test_pictures_are_refused_by_what_needs_more(tmp_path):
    options = parsed("--output", str(tmp_path / "out.csv"))
    options.data = "pictures:photos"
    with pytest.raises(ValueError, match="^--data: expected clouds, got a folder of pictures"):
        estimate(options, refuse, refuse, needs="clouds")


def test_a_camera_is_for_pictures(three, tmp_path, monkeypatch):
    monkeypatch.setattr(estimating, "open_source", lambda *_, **__: three)
    options = parsed("--output", str(tmp_path / "out.csv"), "--camera", "K.json")
    with pytest.raises(ValueError, match="^--camera: expected nothing, as the data are no pictu"):
        estimate(options, lambda _: Run(), refuse)


def test_drawn_poses(three, tmp_path, monkeypatch, capsys, clock):
    monkeypatch.setattr(estimating, "open_source", lambda *_, **__: three)
    drawn = tmp_path / "drawn"
    options = parsed("--output", str(tmp_path / "out.csv"), "--pictures", str(drawn))
    estimate(options, lambda _: Run(), lambda *_: Counting())
    assert len(list(drawn.iterdir())) == 3
    assert f"{drawn}: 3 of 3 images with their poses" in capsys.readouterr().out


def test_nothing_found_is_said(three, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(estimating, "open_source", lambda *_, **__: three)

    class Blind:
        def estimate(self, images, K):
            return []

    options = parsed("--output", str(tmp_path / "out.csv"))
    estimate(options, lambda _: Run(), lambda *_: Blind())
    assert capsys.readouterr().err == "note: no object was found\n"
