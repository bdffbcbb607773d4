"""BOP's average recall beside a plain loop of its published matching, where images hold several."""

import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_tools.bop import write_results
from posecore.methods.main import main
from posecore.metrics import PoseTable, evaluation
from posecore.metrics.report import summarise
from posecore.models import ObjectModel
from tests.metrics.bop_loop import THRESHOLDS, average_recall, detection_precision, scaled

K = np.array([[570.0, 0, 320], [0, 575, 240], [0, 0, 1]])
WIDTH = 720
IMAGES = [(1, 0), (1, 1), (2, 0)]


def turn(angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
    return T


BOX = np.array(list(itertools.product((-0.03, 0.03), (-0.04, 0.04), (-0.05, 0.05))))
MODELS = {
    7: ObjectModel(7, BOX, 0.1414, centre=np.zeros(3), size=np.ptp(BOX, 0)),
    8: ObjectModel(
        *(8, BOX, 0.1414),
        symmetries=np.stack([np.eye(4), turn(np.pi)]),
        centre=np.zeros(3),
        size=np.ptp(BOX, 0),
    ),
}


def scenes(seed):
    """Poses close together in three images, and estimates near them whose pairing is not clear."""
    rng = np.random.default_rng(seed)
    poses, estimates = [], []
    for image, object_id in itertools.product(IMAGES, MODELS):
        middle = np.array([0, 0, 0.8]) + rng.uniform(-0.1, 0.1, 3)
        here = []
        for _ in range(rng.integers(1, 5)):
            R = Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix()
            here.append((R, middle + rng.normal(0, 0.03, 3)))
            poses.append({"image": image, "object": object_id, "R": R, "t": here[-1][1]})
        for _ in range(rng.integers(0, 7)):
            R, t = here[rng.integers(len(here))]
            R = R @ Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix()
            score = rng.choice([0.2, 0.5, 0.5, 0.9])  # some are equal
            t = t + rng.normal(0, 0.02, 3)
            estimates.append(
                {"image": image, "object": object_id, "R": R, "t": t, "score": float(score)}
            )
    return poses, [estimates[i] for i in rng.permutation(len(estimates))]


def table(rows):
    column = lambda name, default=None: [row.get(name, default) for row in rows]  # noqa: E731
    images = np.reshape([row["image"] for row in rows], (-1, 2)).astype(int)
    return PoseTable(
        *images.T,
        np.array(column("object"), int),
        np.reshape(column("R"), (-1, 3, 3)),
        np.reshape(column("t"), (-1, 3)),
        np.array(column("score", 1.0), float),
        np.full(len(rows), -1.0),
    )


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_recalls_are_those_of_the_loop(seed):
    poses, estimates = scenes(seed)
    errors = evaluation.evaluate(table(estimates), table(poses), MODELS, K, images=IMAGES)
    values = summarise(list(errors.values()), WIDTH)
    counts = {}
    for pose in poses:
        key = pose["image"], pose["object"]
        counts[key] = counts.get(key, 0) + 1
    for name in ("mssd", "mspd"):
        expected = average_recall(
            name, estimates, poses, [True] * len(poses), counts, MODELS, K, WIDTH
        )
        got = values["BOP average recall, %", name.upper()]
        assert got == pytest.approx(100 * expected, abs=1e-9), name


@pytest.mark.slow
def test_pairs_by_distance_would_give_others():
    """What the loop guards: the nearest origins are not BOP's pairs."""
    different = 0
    for seed in range(20):
        poses, estimates = scenes(seed)
        errors = evaluation.evaluate(table(estimates), table(poses), MODELS, K, images=IMAGES)
        for part in errors.values():
            alone = np.mean(part.errors["mssd"][:, None] / part.diameter < 0.05 * np.arange(1, 11))
            value = summarise([part])["BOP average recall, %", "MSSD"]
            different += abs(value - 100 * alone) > 1e-9
    assert different > 5


@pytest.mark.parametrize("least", [None, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_targets_and_their_counts(tmp_path, capsys, seed, least):
    """Of several instances the most visible ones are targets; the others can be taken by nobody.

    With `--visible` all that are visible enough may be taken, by as many estimates as before.
    """
    poses, estimates = scenes(seed)
    rng = np.random.default_rng(seed)
    for pose in poses:
        pose["visible"] = float(np.round(rng.uniform(0, 1), 3))
    there, valid, counts, targets = {}, [False] * len(poses), {}, []
    for number, pose in enumerate(poses):
        there.setdefault((pose["image"], pose["object"]), []).append(number)
    for (image, object_id), numbers in there.items():
        if (image, object_id) == (IMAGES[0], 8):
            continue  # an object that is there, but is no target
        counts[image, object_id] = count = int(rng.integers(1, len(numbers) + 1))
        targets.append(
            {"scene_id": image[0], "im_id": image[1], "obj_id": object_id, "inst_count": count}
        )
        for number in sorted(numbers, key=lambda i: -poses[i]["visible"])[:count]:
            valid[number] = True
    write_dataset(tmp_path, poses, targets)
    write_results(tmp_path / "est.csv", table(estimates))
    words = ["evaluate", str(tmp_path / "est.csv"), f"bop:{tmp_path}", "--targets", "targets.json"]
    if least is not None:
        words += ["--visible", str(least)]
        valid = [
            (pose["image"], pose["object"]) in counts and pose["visible"] >= least for pose in poses
        ]
    assert main([*words, "--json", str(tmp_path / "out.json")]) == 0, capsys.readouterr().err
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["poses"]["ground truth"]["all poses"] == sum(valid)
    for name in ("mssd", "mspd"):
        expected = average_recall(name, estimates, poses, valid, counts, MODELS, K, WIDTH)
        got = content["BOP average recall, %"][name.upper()]["all poses"]
        assert got == pytest.approx(100 * expected, abs=1e-6), name
        gap = scaled(name, estimates, poses, MODELS, K, WIDTH)
        counted = [pose["visible"] >= (0.1 if least is None else least) for pose in poses]
        values = [
            detection_precision(gap, THRESHOLDS[name], estimates, poses, counted, i) for i in MODELS
        ]
        got = content["BOP24 detection, average precision, %"][name.upper()]
        assert list(got["objects"].values()) == pytest.approx([100 * v for v in values], abs=1e-6)
        assert got["mean of objects"] == pytest.approx(100 * np.mean(values), abs=1e-6)


def write_dataset(folder, poses, targets):
    """In BOP's layout, with the models of `MODELS`."""
    for scene in {pose["image"][0] for pose in poses}:
        (path := folder / "test" / f"{scene:06d}").mkdir(parents=True)
        gt, info, cameras = {}, {}, {}
        for pose in (pose for pose in poses if pose["image"][0] == scene):
            image = str(pose["image"][1])
            R, t = pose["R"].ravel().tolist(), (1000 * pose["t"]).tolist()
            entry = {"obj_id": pose["object"], "cam_R_m2c": R, "cam_t_m2c": t}
            gt.setdefault(image, []).append(entry)
            seen = {"visib_fract": pose["visible"], "bbox_visib": [0, 0, 1, 1]}
            info.setdefault(image, []).append(seen)
            cameras[image] = {"cam_K": K.ravel().tolist(), "depth_scale": 1.0}
        for name, content in (("gt", gt), ("gt_info", info), ("camera", cameras)):
            (path / f"scene_{name}.json").write_text(json.dumps(content))
    (models := folder / "models").mkdir()
    infos = {}
    for object_id, model in MODELS.items():
        infos[str(object_id)] = {"diameter": 1000 * model.diameter} | {
            f"{key}_{axis}": 1000 * value
            for key, values in (("min", BOX.min(0)), ("size", np.ptp(BOX, 0)))
            for axis, value in zip("xyz", values.tolist(), strict=True)
        }
        if model.symmetries is not None:
            infos[str(object_id)]["symmetries_discrete"] = [model.symmetries[1].ravel().tolist()]
        lines = [" ".join(map(repr, row)) for row in (1000 * BOX).tolist()]
        faces = ["3 0 1 2", "3 1 2 3"]
        head = (
            f"ply\nformat ascii 1.0\nelement vertex {len(BOX)}\nproperty double x\n"
            f"property double y\nproperty double z\nelement face {len(faces)}\n"
            "property list uchar int vertex_indices\nend_header"
        )
        text = "\n".join([head, *lines, *faces]) + "\n"
        (models / f"obj_{object_id:06d}.ply").write_text(text)
    (models / "models_info.json").write_text(json.dumps(infos))
    (folder / "camera.json").write_text(json.dumps({"width": WIDTH, "height": 480}))
    (folder / "targets.json").write_text(json.dumps(targets))
