"""BOP's scores by the command line beside plain loops: on a world of ours, and on LM-O's results.

The loops draw models by casting a ray through each pixel, and share nothing with what they check
but the readers.
"""

import json
from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_tools.bop import BopDataset, Models, read_results, write_results
from data_tools.bop.pieces import visible_fractions
from data_tools.main import main as data_main
from posecore.methods.evaluating import _to_object_models
from posecore.methods.main import main
from posecore.metrics import PoseTable
from tests.metrics import bop_loop

RECALL, DETECTION = "BOP average recall, %", "BOP24 detection, average precision, %"


def cast(mesh, R, t, K, shape):
    """The depth of a mesh: each ray (x, y, 1) as a sum of the corners of each triangle near it.

    If no weight is negative the ray hits the triangle, and 1 / (their sum) is the depth there.
    """
    depth = np.full(shape, np.inf)
    corners = mesh.vertices[mesh.faces] @ R.T + t  # (F, 3, 3), all of them in front of the camera
    assert corners[..., 2].min() > 0
    seen = corners @ K.T
    pixels = seen[..., :2] / seen[..., 2:]
    low = np.clip(np.ceil(pixels.min(1)), 0, None).astype(int)
    high = np.minimum(np.floor(pixels.max(1)).astype(int), np.array(shape[::-1]) - 1)
    flat = abs(np.linalg.det(corners)) < 1e-15  # seen from their edge
    near = np.flatnonzero((low <= high).all(1) & ~flat)
    for i, inverse in zip(near, np.linalg.inv(corners[near].mT), strict=True):
        x, y = np.meshgrid(*(np.arange(*pair) for pair in zip(low[i], high[i] + 1, strict=True)))
        rays = [(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones(x.shape)]
        weights = np.tensordot(inverse, rays, 1)
        hit = (weights >= 0).all(0)
        some = y[hit], x[hit]
        depth[some] = np.minimum(depth[some], 1 / weights.sum(0)[hit])
    return np.where(np.isinf(depth), 0, depth)


def listed(table, **more):
    """A table as the loops want it."""
    columns = {name: values.tolist() for name, values in more.items()}
    rows = zip(table.images, table.object_id.tolist(), table.R, table.t, table.score, strict=True)
    return [
        {"image": image, "object": i, "R": R, "t": t, "score": float(score)}
        | {name: values[row] for name, values in columns.items()}
        for row, (image, i, R, t, score) in enumerate(rows)
    ]


def vsd_gap(dataset, estimates, poses, models):
    """`gap(estimate, pose)`: VSD for all tolerances, each pair measured once."""
    drawn, known, depths = {}, {}, {}
    meshes = dataset.models()

    def draw(kind, row):
        if (kind, row) not in drawn:
            one = (estimates if kind == "est" else poses)[row]
            image = one["image"]
            if image not in depths:
                depths[image] = dataset[dataset.images.index(image)].depth
            K, mesh = dataset.camera(*image).K, meshes.mesh(one["object"])
            drawn[kind, row] = cast(mesh, one["R"], one["t"], K, depths[image].shape)
        return drawn[kind, row]

    def gap(k, number):
        if (k, number) not in known:
            one, image = estimates[k], poses[number]["image"]
            both = draw("est", k), draw("gt", number)
            K, diameter = dataset.camera(*image).K, models[one["object"]].diameter
            arguments = (*both, depths[image], K, diameter, 0.015, bop_loop.TAUS)
            known[k, number] = bop_loop.vsd(*arguments)
        return known[k, number]

    return gap


def all_gaps(dataset, estimates, poses, models, width):
    """Those of MSSD, MSPD and VSD."""
    K = dataset.camera(*dataset.images[0]).K
    given = estimates, poses, models
    gaps = {name: bop_loop.scaled(name, *given, K, width) for name in ("mssd", "mspd")}
    return gaps | {"vsd": vsd_gap(dataset, *given)}


def expected_recalls(gaps, estimates, poses, valid, counts):
    """VSD, MSSD, MSPD and their mean, %."""
    given, recalls = (estimates, poses, valid, counts), {}
    for name in ("vsd", "mssd", "mspd"):
        some = [gaps[name]]
        if name == "vsd":
            some = [lambda k, number, at=at: gaps["vsd"](k, number)[at] for at in range(10)]
        thresholds = bop_loop.THRESHOLDS[name]
        recalls[name.upper()] = 100 * np.mean(
            [bop_loop.recall(gap, threshold, *given) for gap in some for threshold in thresholds]
        )
    return recalls | {"AR, their mean": np.mean([*recalls.values()])}


def written(*words, folder):
    """What `evaluate` says of a dataset."""
    assert main(["evaluate", *words, "--json", str(folder / "out.json")]) == 0
    return json.loads((folder / "out.json").read_text())


@pytest.fixture(scope="module")
def world(tmp_path_factory, shared_cache):
    """Two images of each split of `tabletop`, as a BOP dataset."""
    path = tmp_path_factory.mktemp("exported") / "tabletop"
    assert data_main(["export", str(path), "--scale", "tiny", "--count", "2"]) == 0
    return path


@pytest.fixture(scope="module")
def guesses(world):
    """Estimates of the occluded images: near, far, none, two, or of what is not there.

    Returns them and the true poses as the loops want them, and the gaps between them.
    """
    rng = np.random.default_rng(0)
    dataset = BopDataset(world, "test_occluded")
    truth, columns = dataset.ground_truth(), []
    there = {(*image, i) for image, i in zip(truth.images, truth.object_id, strict=True)}
    for row in range(len(truth)):
        ids = truth.scene_id[row], truth.image_id[row]
        for _ in range(rng.choice([0, 1, 1, 2])):
            R = Rotation.from_rotvec(rng.normal(0, 0.15, 3)).as_matrix() @ truth.R[row]
            t = truth.t[row] + rng.normal(0, 0.006, 3)
            columns.append((*ids, truth.object_id[row], R, t, rng.choice([0.3, 0.6, 0.9]), 0.25))
        if (*ids, other := 1 + row % 8) not in there:
            columns.append((*ids, other, truth.R[row], truth.t[row], 0.5, 0.25))
    table = PoseTable(*map(np.array, zip(*columns, strict=True)))
    write_results(world / "guesses.csv", table)
    models = _to_object_models(dataset.models(), set(truth.object_id.tolist()))
    estimates, poses = listed(table), listed(truth)
    return estimates, poses, all_gaps(dataset, estimates, poses, models, 96)


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--visible", "0.3"], ["--targets"]])
def test_a_world_of_ours(world, guesses, tmp_path, options, capsys):
    """Its own models, drawn and cast; occluded images, so that what is hidden matters."""
    dataset = BopDataset(world, "test_occluded")
    shares, (estimates, poses, gaps) = visible_fractions(dataset), guesses
    valid, least = np.ones(len(poses), bool), 0.1
    if options == ["--targets"]:
        entries = [
            {"scene_id": p["image"][0], "im_id": p["image"][1], "obj_id": p["object"]}
            for p in poses[::2]
        ]
        (tmp_path / "targets.json").write_text(json.dumps(entries))
        options, valid[1::2] = ["--targets", str(tmp_path / "targets.json")], False
    elif options:
        valid, least = shares >= 0.3, 0.3
        assert 0 < valid.sum() < len(valid)
    counts = Counter((p["image"], p["object"]) for p, v in zip(poses, valid, strict=True) if v)
    words = [str(world / "guesses.csv"), f"bop:{world}", "--split", "test_occluded", *options]
    content = written(*words, folder=tmp_path)
    expected = expected_recalls(gaps, estimates, poses, valid.tolist(), counts)
    got = {label: line["all poses"] for label, line in content[RECALL].items()}
    assert got == pytest.approx(expected, abs=1e-9)
    assert 5 < got["VSD"] < 95
    counted = (shares >= least).tolist()
    for name in ("mssd", "mspd"):
        given = gaps[name], bop_loop.THRESHOLDS[name], estimates, poses, counted
        for i, value in content[DETECTION][name.upper()]["objects"].items():
            precision = bop_loop.detection_precision(*given, int(i))
            assert value is precision is None or value == pytest.approx(100 * precision, abs=1e-9)
    assert content["time"]["seconds of an image"] == {"mean": 0.25, "images": 2}
    err, hidden = capsys.readouterr().err, int((shares < 0.1).sum())
    assert (f"{hidden} of {len(poses)} true poses are less than 10% visible" in err) == bool(
        hidden and not options
    )


@pytest.fixture(scope="module")
def lmo(real_data):
    """LM-O's one frame, and MegaPose's estimates for it, of the can."""
    estimates = read_results(real_data / "bop_results" / "megapose_lmo-test.csv")
    return BopDataset(real_data / "lmo"), estimates


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::data_tools.bop.RotationWarning")
def test_the_frame_of_lmo(lmo, real_data, tmp_path):
    """All three, of the can that is really there."""
    dataset, everything = lmo
    table = dataset.ground_truth()
    rows = [(2, 3) == image for image in everything.images] & (everything.object_id == 5)
    poses, estimates = listed(table[table.object_id == 5]), listed(everything[rows])
    assert len(poses) == 1 and len(estimates) >= 1
    results = str(real_data / "bop_results" / "megapose_lmo-test.csv")
    words = [results, f"bop:{real_data / 'lmo'}", "--objects", "5"]
    content = written(*words, folder=tmp_path)
    models = _to_object_models(dataset.models(), {5})
    gaps = all_gaps(dataset, estimates, poses, models, 640)
    expected = expected_recalls(gaps, estimates, poses, [True], {((2, 3), 5): 1})
    got = {label: line["objects"]["5"] for label, line in content[RECALL].items()}
    assert got == pytest.approx(expected, abs=1e-9)
    assert 50 < got["VSD"] < 100  # a good pose, of which depth and model differ by 6 mm


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::data_tools.bop.RotationWarning")
def test_lmo_without_depth(real_data, tmp_path, capsys):
    """MegaPose's estimates of the can in every fourth image: no VSD, and why; all the rest."""
    results = real_data / "bop_results" / "megapose_lmo-test.csv"
    table, truth = read_results(results), read_results(results.with_name("gt_lmo-test.csv"))
    truth = truth[truth.object_id == 5][::4]
    write_results(tmp_path / "truth.csv", truth)
    models = real_data / "lmo" / "models"
    words = [str(results), str(tmp_path / "truth.csv"), "--models", str(models)]
    content = written(*words, folder=tmp_path)
    estimates, poses = listed(table[table.object_id == 5]), listed(truth)
    known = _to_object_models(Models(models), {5})
    camera = json.loads((real_data / "lmo" / "camera.json").read_text())
    K = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]])
    valid, counts = [True] * len(poses), Counter((p["image"], p["object"]) for p in poses)
    for name in ("mssd", "mspd"):
        gap = bop_loop.scaled(name, estimates, poses, known, K, 640)
        limits = bop_loop.THRESHOLDS[name]
        recall = np.mean([bop_loop.recall(gap, t, estimates, poses, valid, counts) for t in limits])
        got = content[RECALL][name.upper()]["objects"]["5"]
        assert got == pytest.approx(100 * recall, abs=1e-9)
        precision = bop_loop.detection_precision(gap, limits, estimates, poses, valid, 5)
        got = content[DETECTION][name.upper()]["objects"]["5"]
        assert got == pytest.approx(100 * precision, abs=1e-9)
    assert set(content[RECALL]) == {"MSSD", "MSPD"}
    err = capsys.readouterr().err
    assert "note: no VSD and no AR, which need depth images: a CSV file has none" in err
