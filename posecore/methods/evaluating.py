"""`evaluate`: estimated poses against ground truth, with every metric of the field."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

import data_tools
from data_tools.bop import Models, read_results
from data_tools.bop.files import read_json, read_number
from posecore import figures, rotations
from posecore.arrays import fail
from posecore.files import write_bytes
from posecore.methods.notes import note
from posecore.metrics import evaluation, report
from posecore.metrics.pose_table import PoseTable

__all__ = ["add_evaluate", "evaluate"]

DESCRIPTION = """Measure estimated poses against ground truth with every metric of the field.
Estimates are a CSV file in the BOP format (scene_id,im_id,obj_id,score,R,t,time; millimetres);
ground truth is such a file too, or bop:PATH, the folder of a BOP dataset. A pose that was not
estimated counts as wrong; of an image with n instances of an object the n surest estimates are
taken."""
CURVE_ENDINGS = (".png", ".pdf", ".svg")
WIDTH = 640.0  # pixels, of BOP's thresholds on MSPD, which grow with the images


class Truth(NamedTuple):
    """What the estimates are measured against."""

    poses: PoseTable
    images: list[tuple[int, int]]
    """(scene id, image id) of the evaluated images, some of which may hold no object."""
    models: Models
    K: np.ndarray | None
    """(3, 3), or (G, 3, 3) for each pose."""
    width: float
    """Of the images, in pixels."""


def add_evaluate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `evaluate` to the commands."""
    command = commands.add_parser(
        "evaluate", help="measure estimated poses with every metric", description=DESCRIPTION
    )
    command.set_defaults(command=evaluate)
    command.add_argument("estimates", metavar="ESTIMATES.csv")
    command.add_argument("ground_truth", metavar="GROUND_TRUTH", help="a CSV file, or bop:PATH")
    command.add_argument("--split", help="with bop:PATH: which part, if there are several")
    command.add_argument("--targets", metavar="FILE", help="with bop:PATH: test_targets_bop19.json")
    command.add_argument(
        "--models",
        metavar="DIR",
        help="folder with models_info.json and obj_000001.ply (default: those of bop:PATH)",
    )
    command.add_argument(
        "--camera",
        metavar="FILE",
        help="camera.json with fx, fy, cx, cy and width of the images of a CSV file "
        "(default: beside DIR; without it no pixel errors)",
    )
    command.add_argument(
        "--rotations",
        choices=("project", "as_read"),
        default="project",
        help="published rotations are not always orthonormal: take the nearest rotation (default), "
        "or the numbers as they are, to reproduce others' distances; then such objects get no "
        "angles",
    )
    command.add_argument("--objects", metavar="ID", type=int, nargs="+", help="default: all")
    command.add_argument(
        "--curve", metavar="FILE", help="draw the accuracy curve of ADD(-S): .png, .pdf or .svg"
    )
    command.add_argument("--json", metavar="FILE", help="write all values, unrounded")


def evaluate(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or files that do not fit or are damaged.
        OSError: if a file cannot be read or written.
    """
    _check_outputs(options)
    estimates = read_results(options.estimates, rotations=options.rotations)
    is_dataset = options.ground_truth.startswith("bop:")
    truth = (_from_dataset if is_dataset else _from_files)(options)
    wanted = set(truth.poses.object_id.tolist() if options.objects is None else options.objects)
    models = _to_object_models(truth.models, wanted)
    errors = evaluation.evaluate(
        estimates, truth.poses, models, truth.K, options.objects, truth.images
    )
    _explain(estimates, truth, models, list(errors))
    lines = report.report(errors, truth.width)
    print(report.to_text(lines))
    if options.json:
        write_bytes(Path(options.json), _to_json(lines))
    if options.curve:
        write_bytes(Path(options.curve), _draw(errors, Path(options.curve).suffix[1:].lower()))


def _check_outputs(options: argparse.Namespace) -> None:
    """Refuse what could not be written in the end, before all the work."""
    for name in ("curve", "json"):
        file = getattr(options, name)
        if file and not Path(file).resolve().parent.is_dir():
            fail(f"--{name}", "a file in a folder that exists", file)
    if options.curve and Path(options.curve).suffix.lower() not in CURVE_ENDINGS:
        fail("--curve", "a file that ends in " + ", ".join(CURVE_ENDINGS), options.curve)


def _from_dataset(options: argparse.Namespace) -> Truth:
    if options.camera:
        fail("--camera", "nothing, as every image of bop:PATH has a camera", options.camera)
    dataset = data_tools.open(
        options.ground_truth,
        split=options.split,
        targets=options.targets,
        rotations=options.rotations,
    )
    poses = dataset.ground_truth()
    K = np.reshape([dataset.camera(*image).K for image in poses.images], (-1, 3, 3))
    models = Models(options.models) if options.models else dataset.models()
    path = dataset.path / "camera.json"
    if path.is_file():
        return Truth(
            poses, dataset.images, models, K, read_number(str(path), read_json(path), "width")
        )
    note(f"no {path}: images are taken to be {WIDTH:.0f} pixels wide (thresholds of MSPD)")
    return Truth(poses, dataset.images, models, K, WIDTH)


def _from_files(options: argparse.Namespace) -> Truth:
    if not options.models:
        fail("--models", "a folder of models", "none")
    for name in ("split", "targets"):
        if getattr(options, name):
            fail(f"--{name}", "nothing, as the ground truth is no bop:PATH", getattr(options, name))
    poses = read_results(options.ground_truth, rotations=options.rotations)
    models = Models(options.models)
    path = Path(options.camera or Path(options.models).resolve().parent / "camera.json")
    if not options.camera and not path.is_file():
        note(f"no {path}, so no errors in pixels (--camera names another)")
        return Truth(poses, poses.images, models, None, WIDTH)
    camera = read_json(path)
    fx, fy, cx, cy = (read_number(str(path), camera, name) for name in ("fx", "fy", "cx", "cy"))
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Truth(poses, poses.images, models, K, read_number(str(path), camera, "width"))


def _to_object_models(models: Models, wanted: set[int]) -> dict[int, evaluation.ObjectModel]:
    """The models of the wanted objects that have a mesh."""
    result = {}
    for object_id in sorted(wanted & set(models.ids)):
        try:
            points = models.mesh(object_id).vertices
        except FileNotFoundError as error:
            note(str(error))
            continue
        info = models.info(object_id)
        extent = float(np.ptp(points, axis=0).max())
        if not 0.5 < extent / info.diameter < 2:
            note(
                f"object {object_id}: the mesh measures {extent:.4g} m, its diameter is said to be "
                f"{info.diameter:.4g} m: both should be in millimetres on disk"
            )
        symmetries = info.symmetries()
        result[object_id] = evaluation.ObjectModel(
            points=points,
            diameter=info.diameter,
            centre=info.minimum + info.size / 2,
            size=info.size,
            symmetries=symmetries if len(symmetries) > 1 else None,
        )
    return result


def _explain(
    estimates: PoseTable, truth: Truth, models: dict[int, evaluation.ObjectModel], ids: list[int]
) -> None:
    """Say what was left out, and what looks odd."""
    bare = [i for i in ids if i not in models]
    if bare:
        note(f"no model of objects {bare}: for them only errors of rotation and translation")
    poses = truth.poses
    foreign = ~evaluation.in_images(estimates, truth.images)
    if foreign.any():
        note(
            f"{foreign.sum()} of {len(estimates)} estimates are ignored: "
            "the ground truth does not have their images"
        )
    strangers = sorted(set(estimates.object_id[~foreign].tolist()) - set(poses.object_id.tolist()))
    if strangers:
        note(f"estimates of objects {strangers} are ignored: the ground truth holds none")
    for name, table in (("estimates", estimates), ("ground truth", poses)):
        table = table[np.isin(table.object_id, ids)]
        improper = ~rotations.is_rotation(table.R)
        if improper.any():
            note(
                f"{improper.sum()} of {len(table)} matrices of the {name} are not rotations: no "
                f"angles and boxes of objects {np.unique(table.object_id[improper]).tolist()} "
                "(--rotations project takes the nearest rotations)"
            )
    far = [np.median(np.linalg.norm(table.t, axis=1)) for table in (estimates, poses) if len(table)]
    if len(far) == 2 and not 1 / 50 < far[0] / far[1] < 50:
        note(
            f"estimates are {far[0]:.3g} m from the camera, the ground truth {far[1]:.3g} m: "
            "both files should be in millimetres"
        )


def _to_json(lines: list[report.Line]) -> bytes:
    def number(value: float | None) -> float | None:
        return value if value is not None and np.isfinite(value) else None  # JSON has no infinity

    content: dict = {}
    for line in lines:
        content.setdefault(line.section, {})[line.label] = {
            "objects": {i: number(value) for i, value in line.objects.items()},
            "all poses": number(line.pooled),
            "mean of objects": number(line.mean),
        }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def _draw(errors: dict[int, evaluation.ObjectErrors], kind: str) -> bytes:
    curves = {
        f"object {i}": one.errors["add_or_s"]
        for i, one in errors.items()
        if "add_or_s" in one.errors
    }
    if not curves:
        fail("--curve", "at least one object with a model", "none")
    everything = None
    if len(curves) > 1:
        everything = "all poses"
        curves[everything] = np.concatenate(list(curves.values()))
    figure = figures.accuracy_curves(curves, name="ADD(-S)", highlight=everything)
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=150)
    return buffer.getvalue()
