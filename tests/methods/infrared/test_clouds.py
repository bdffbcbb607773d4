"""Predicted clouds on disk."""

import json
import os
from dataclasses import replace

import pytest
import safetensors.torch
import torch

from posecore.methods.infrared import clouds
from posecore.methods.infrared.clouds import CloudSet, made_from, predict, read_clouds
from posecore.methods.infrared.network import CloudNet
from posecore.poses import to_matrix
from posecore.randomness import seeded
from posecore.rotations import axis_angle_to_matrix


def some(views=4, points=5):
    g = torch.Generator().manual_seed(0)

    def uniform(*shape):
        return torch.rand(shape, generator=g)

    R = axis_angle_to_matrix(uniform(views, 3).double())
    return CloudSet(
        points=(uniform(views, points, 3) - 0.5).half(), intensities=uniform(views, points).half(),
        t=uniform(views, 3), scale=uniform(views), net=torch.arange(views) % 2,
        scene_id=torch.arange(views), image_id=torch.arange(views) + 7,
        group=torch.arange(views) // 3, T_world_cam=to_matrix(R, uniform(views, 3).double()),
        made_from={"weights": ["ab", "cd"], "images": "ef"},
    )  # fmt: skip


def test_written_and_read(tmp_path):
    kept = some()
    path = tmp_path / "clouds.safetensors"
    kept.write(path)
    found = read_clouds(path)
    assert len(found) == 4 and found.made_from == kept.made_from
    for name, tensor in kept._tensors().items():
        other = getattr(found, name)
        assert tensor.dtype == other.dtype and torch.equal(tensor, other)
    first = path.read_bytes()
    for _ in range(8):  # several entries of metadata would come in any order
        kept.write(path)
        assert path.read_bytes() == first
    assert os.listdir(tmp_path) == [path.name]


def test_views_of_one_tensor_are_written_too(tmp_path):
    """Parts of a batch, transposed or repeated."""
    kept = some()
    odd = replace(
        kept, t=kept.t[:1].expand(4, 3), T_world_cam=kept.T_world_cam.mT,
        scene_id=kept.image_id, image_id=kept.image_id,
    )  # fmt: skip
    odd.write(tmp_path / "c")
    found = read_clouds(tmp_path / "c")
    for name, tensor in odd._tensors().items():
        assert torch.equal(tensor, getattr(found, name))


def test_in_the_world():
    kept = some()
    found = kept.in_world()
    assert found.shape == (4, 5, 3) and found.dtype == torch.float64
    for v in range(4):
        pose = kept.T_world_cam[v]
        for n in range(5):
            point = kept.points[v, n].double() + kept.t[v].double()
            expected = pose[:3, :3] @ point + pose[:3, 3]
            torch.testing.assert_close(found[v, n], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["t", "scale", "net", "group", "T_world_cam"])
def test_other_numbers_of_views(name):
    kept = some()
    with pytest.raises(ValueError, match=rf"^{name}: expected shape \(4,.*got shape \(3,"):
        replace(kept, **{name: getattr(kept, name)[:3]})


@pytest.mark.parametrize("name", ["points", "intensities", "t", "scale", "T_world_cam"])
def test_what_is_not_finite(name):
    kept = some()
    value = getattr(kept, name).clone()
    value.flatten()[1] = torch.nan
    with pytest.raises(ValueError, match=f"^{name}: expected finite"):
        replace(kept, **{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", torch.zeros(4, 5)), ("points", torch.zeros(4, 5, 2).half()),
        ("points", torch.zeros(4, 5, 3)), ("intensities", torch.zeros(4, 6).half()),
        ("t", torch.zeros(4)), ("scale", torch.zeros(4, 1)), ("net", torch.zeros(4)),
        ("group", torch.tensor(4)), ("T_world_cam", torch.zeros(4, 3, 3).double()),
        ("T_world_cam", torch.zeros(4, 4, 4)), ("image_id", [0, 1, 2, 3]), ("image_id", None),
    ],
)  # fmt: skip
def test_other_shapes_and_types(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        replace(some(), **{name: value})


def of_a_network(path):
    safetensors.torch.save_file({"weight": torch.zeros(3)}, path)


def turned(path):
    data = bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(data)


def less(path):
    """As of an older or a newer layout, but whole."""
    kept = some()._tensors()
    del kept["net"]
    about = {"made_from": {}, "digest": clouds.weights.digest(kept)}
    safetensors.torch.save_file(kept, path, {clouds.ABOUT: json.dumps(about)})


def undigested(path):
    safetensors.torch.save_file(some()._tensors(), path, {clouds.ABOUT: '{"made_from": {}}'})


def said(words):
    """A whole file that says something else of what its clouds were made from."""

    def damage(path):
        kept = some()._tensors()
        digest = clouds.weights.digest(kept)
        about = words if isinstance(words, str) else json.dumps({"digest": digest, **words})
        safetensors.torch.save_file(kept, path, {clouds.ABOUT: about})

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-9]), lambda path: path.write_bytes(b""),
        lambda path: path.write_text("clouds"), turned, of_a_network, less,
        undigested, said({"made_from": None}), said({"made_from": [1]}), said("null"),
        said("[" * 100_000),
    ],
)  # fmt: skip
def test_damaged_files_are_named(tmp_path, damage):
    path = tmp_path / "clouds.safetensors"
    some().write(path)
    damage(path)
    with pytest.raises(ValueError, match=r"clouds\.safetensors: damaged: "):
        read_clouds(path)


def test_no_file(tmp_path):
    for path in (tmp_path / "clouds", tmp_path):
        with pytest.raises(ValueError, match="^path: expected a file that `clouds infrared` wrote"):
            read_clouds(path)


def test_the_old_file_or_the_new_one(tmp_path, monkeypatch):
    path = tmp_path / "clouds.safetensors"
    some().write(path)
    before = path.read_bytes()

    def broken(*_):
        raise OSError("full")

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(OSError, match="full"):
        some(6).write(path)
    assert path.read_bytes() == before and os.listdir(tmp_path) == [path.name]


# Prediction ---------------------------------------------------------------------------------------


def network(seed=0):
    with seeded(seed):
        return CloudNet((64, 48), 7, width=4, blocks=3, hidden=16).eval()


def test_many_images_are_predicted_a_part_after_the_other(triples, monkeypatch):
    net = network()
    images = triples.images.flatten(0, 1)
    with torch.no_grad():
        expected = net(images.float() / 255)
    monkeypatch.setattr(clouds, "AT_ONCE", 5)
    found = predict(net, images)
    for one, other in zip(found, expected, strict=True):
        assert not one.requires_grad
        torch.testing.assert_close(one, other, rtol=0, atol=1e-6)


def test_the_key_tells_weights_and_images_apart(triples):
    net, other = network(), network(1)
    key = made_from([net], triples)
    assert made_from([network()], triples) == key
    assert made_from([other], triples) != key
    assert made_from([net, other], triples) != key
    assert made_from([net], triples.only(torch.tensor([0, 1]))) != key
    changed = triples.only(torch.arange(4))
    assert made_from([net], changed) == key
    changed.images = changed.images.clone()
    changed.images[2, 1, 0, 5, 5] += 1
    assert made_from([net], changed) != key
    moved = triples.only(torch.arange(4))
    moved.T_world_cam = moved.T_world_cam + 1e-3
    assert made_from([net], moved) != key
    assert made_from([net], replaced_masks(triples)) == key  # of which a cloud is not made


def replaced_masks(triples):
    other = triples.only(torch.arange(4))
    other.masks = torch.zeros_like(other.masks)
    return other
