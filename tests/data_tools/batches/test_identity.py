import itertools
import json
import shutil

import numpy as np
import pytest
import torch

import data_tools
from data_tools import batches
from data_tools.batches.identity import identify
from data_tools.bop.writing import write_dataset
from data_tools.worlds import tabletop
from tests.data_tools.batches.conftest import open_world


@pytest.fixture(scope="module")
def exported(cache, tmp_path_factory):
    """Four views of tabletop as a BOP dataset."""
    folder = tmp_path_factory.mktemp("bop") / "tabletop"
    models = tabletop.WORLD.models
    write_dataset(
        {"test": itertools.islice(open_world("tabletop"), 4)},
        folder,
        {i: models.mesh(i) for i in models.ids},
        infos={i: models.info(i) for i in models.ids},
        silhouettes=tabletop.silhouettes,
        depth_scale=tabletop.DEPTH_SCALE,
    )
    return folder


@pytest.mark.slow
def test_a_bop_dataset_gives_the_same_batches(exported, tmp_path, stack_of):
    dataset = data_tools.open(f"bop:{exported}", split="test")
    batches.load(dataset, folder=tmp_path, progress=False)
    again = batches.load(dataset, folder=tmp_path, progress=False)
    (path,) = tmp_path.rglob("*.shard")
    assert path.parent.parent.name == "bop-stack"
    got, expected = (s.frames(torch.arange(4)) for s in (again, stack_of("tabletop")))
    for name in ("rgb", "depth", "instance", "object_id", "row", "box"):
        assert torch.equal(got[name], expected[name]), name
    for name in ("K", "R", "t", "visible_fraction", "size"):
        assert torch.allclose(got[name], expected[name], atol=1e-5), name


@pytest.mark.slow
def test_changed_files_are_another_dataset(exported, tmp_path):
    def name(**options):
        return identify(data_tools.open(f"bop:{copy}", split="test", **options))

    copy = tmp_path / "copy"
    shutil.copytree(exported, copy)
    before = name()
    assert before == identify(data_tools.open(f"bop:{exported}", split="test"))
    assert name(rotations="as_read") != before
    (poses,) = copy.glob("test/*/scene_gt.json")
    text = poses.read_text()
    content = json.loads(text)
    first = next(iter(content.values()))[0]["cam_t_m2c"]
    first[0] = np.nextafter(first[0], 1e9)
    poses.write_text(json.dumps(content))
    assert name() != before
    poses.write_text(text)
    assert name() == before
    image = next(copy.glob("test/*/rgb/*.png"))
    image.write_bytes(image.read_bytes() + b"0")
    assert name() != before


@pytest.mark.slow
def test_targets_are_another_dataset(exported, tmp_path):
    """The same images, but not the same objects in them."""
    first = {}
    for target in json.loads((exported / "test_targets_bop19.json").read_text()):
        first.setdefault(target["im_id"], target)
    few = tmp_path / "few.json"
    few.write_text(json.dumps(list(first.values())))
    whole, part = (
        data_tools.open(f"bop:{exported}", split="test", targets=targets) for targets in (None, few)
    )
    assert whole.images == part.images
    counts = [len(d.ground_truth().object_id) for d in (whole, part)]
    stacks = [batches.load(d, folder=tmp_path, progress=False) for d in (whole, part)]
    assert [len(stack.view) for stack in stacks] == counts
    assert counts[0] > counts[1] == 4


@pytest.mark.slow
def test_worlds_are_known_by_what_they_were_made_from(cache):
    names = [identify(open_world(world)) for world in ("tabletop", "headset", "tabletop")]
    assert names[0] == names[2] != names[1]
    assert names[0][0] == "tabletop"
    other = tabletop.WORLD.open(split="occluded", scale="tiny", progress=False)
    assert identify(other)[1] != names[0][1]


def test_others_have_no_name():
    assert identify(object()) == (None, [])
