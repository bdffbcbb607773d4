"""The folder of a run: what it holds, who made which cloud, and damage to it."""

import json
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.methods.infrared.runs import InfraredRun, read_run
from posecore.randomness import seeded

SCENES = [[1, 3], [0, 2]]


def small(path, scenes=SCENES):
    return InfraredRun(
        path, {"data": "headset", "scale": "tiny", "seed": 0}, (20, 12), 7, width=4, blocks=2,
        max_channels=None, hidden=16, cube=0.5, max_scale=2.0, scenes=scenes,
    )  # fmt: skip


def write(run):
    run.write()
    for number, name in enumerate(run.names):
        with seeded(number):
            run.write_weights(name, run.new_net())
    return run


def test_written_and_read(tmp_path):
    run = write(small(tmp_path))
    found = read_run(tmp_path)
    assert found == run and found.object_ids == []
    assert run.names == ["net0", "net1"]
    images = torch.rand(2, 1, 12, 20)
    clouds = []
    for number, net in enumerate(found.load_nets()):
        assert not net.training
        with seeded(number):
            expected = run.new_net()(images)
        clouds.append(net(images))
        assert torch.equal(clouds[-1].points, expected.points)
    assert not torch.equal(clouds[0].points, clouds[1].points)


def test_one_network_has_no_number(tmp_path):
    run = write(small(tmp_path, [[0, 1, 2, 3]]))
    assert run.names == ["net"] and len(read_run(tmp_path).load_nets()) == 1


# Which network ------------------------------------------------------------------------------------


@given(st.integers(1, 4), st.integers(1, 12), st.integers(0, 10**6))
def test_no_network_makes_the_cloud_of_a_scene_that_it_knows(folds, count, seed):
    """Scenes 0 to count - 1 are divided; of the others none is known."""
    scenes = [[s for s in range(count) if s % folds != k or folds == 1] for k in range(folds)]
    generator = torch.Generator().manual_seed(seed)
    scene = torch.randint(0, count + 3, (40,), generator=generator)
    group = torch.randint(0, 20, (40,), generator=generator)
    found = small("", scenes).net_of(scene, group)
    assert found.dtype == torch.int64 and found.shape == (40,)
    for s, g, net in zip(scene.tolist(), group.tolist(), found.tolist(), strict=True):
        if s >= count:  # divided by groups
            assert net == g % folds
        elif folds == 1:
            assert net == 0
        else:
            assert s not in scenes[net]


def test_without_folds_the_one_network_makes_all():
    run = small("", [[0, 1]])
    assert run.net_of(torch.tensor([0, 1, 7]), torch.tensor([0, 1, 2])).tolist() == [0, 0, 0]


def test_networks_that_know_nothing_yet():
    found = small("", [[], [1]]).net_of(torch.tensor([0, 1, 1]), torch.tensor([1, 1, 0]))
    assert found.tolist() == [1, 0, 0]


# Damage -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": []}, "scenes: expected those of one network or more"),
        ({"scenes": [[0, -1]]}, "scenes: expected"),
        ({"scenes": [["a"]]}, "scenes: expected"),
        ({"scenes": 3}, "damaged"),
        ({"points": 0}, "points: expected"),
        ({"width": "4"}, "width: expected"),
        ({"image": [20]}, "image: expected"),
        ({"image": None}, "damaged"),
        ({"cube": -1}, "cube: expected"),
        ({"max_scale": 0}, "max_scale: expected"),
        ({"max_channels": 0}, "max_channels: expected"),
        ({"method": "vector_field"}, "method: expected infrared"),
        ({"options": {"scale": "huge"}}, "scale: expected"),
        ({"options": {}}, "scale: expected"),
        ({"options": {"scale": None}}, "scale: expected"),
        ({"hidden": None}, "hidden: expected"),
    ],
)
def test_a_damaged_run_is_named(tmp_path, changes, message):
    small(tmp_path).write()
    file = tmp_path / "run.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
    with pytest.raises(ValueError, match=rf"run\.json: damaged.*|{message}") as caught:
        read_run(tmp_path)
    assert message in str(caught.value) and str(file) in str(caught.value)


@pytest.mark.parametrize("entry", ["image", "points", "scenes", "max_channels"])
def test_an_entry_that_is_missing(tmp_path, entry):
    small(tmp_path).write()
    file = tmp_path / "run.json"
    content = json.loads(file.read_text())
    del content[entry]
    file.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=f"damaged: no entry '{entry}'"):
        read_run(tmp_path)


def test_networks_that_are_missing_or_damaged(tmp_path):
    with pytest.raises(ValueError, match="--run: expected a folder that `train infrared` wrote"):
        read_run(tmp_path)
    run = write(small(tmp_path))
    path = tmp_path / "net1.safetensors"
    whole = path.read_bytes()
    path.write_bytes(whole[:-3])
    with pytest.raises(ValueError, match="net1.safetensors: expected the weights of this run"):
        run.load_nets()
    with pytest.raises(ValueError, match="net0.safetensors: expected the weights of this run"):
        replace(run, points=8).load_nets()
    path.unlink()
    with pytest.raises(ValueError, match="--run: expected a run that has trained its net1"):
        run.load_nets()
