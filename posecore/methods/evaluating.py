"""`evaluate`: estimated poses against ground truth."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path

import numpy as np

from data_tools import units
from data_tools.bop import read_results
from data_tools.views import ModelSet
from posecore import rotations
from posecore.arrays import fail, require_number
from posecore.files import write_bytes
from posecore.methods.category_evaluating import evaluate_category_level, is_category_level
from posecore.methods.notes import note
from posecore.methods.outputs import check_outputs, say_beside
from posecore.methods.surfaces import DatasetSurfaces
from posecore.methods.truth import Truth, kind_of, read_truth
from posecore.metrics import bop_scores, evaluation, report
from posecore.metrics.bop_errors import add_bop_errors
from posecore.metrics.pose_table import PoseTable
from posecore.metrics.visible_surface import VSD_DELTA
from posecore.models import ObjectModel

__all__ = ["add_evaluate", "evaluate"]

DESCRIPTION = """Measure estimated poses against ground truth, per object and overall: ADD, ADD-S
and ADD(-S) (below 0.1 d, and the area under the curve to 10 cm), 2D projection, n deg m cm, 3D IoU
of the boxes, errors of rotation, translation and single angles; BOP's average recalls of VSD, MSSD
and MSPD with their mean AR, BOP24's average precision of detection, and the time of an image. VSD,
and with it AR, needs bop:PATH with depth images, in which the models are drawn.
Estimates that have a category and a size in each line (columns category,size after those of BOP)
are measured by the protocol of NOCS: average precision of 3D boxes and of poses. Their ground truth
is such a file with the column axis, or `categories`, the world."""
EPILOG = """Estimates are a CSV file in the BOP format (scene_id,im_id,obj_id,score,R,t,time;
millimetres); ground truth is such a file too, or bop:PATH, linemod:PATH or hmdpose:PATH, the folder
of a dataset. A pose that was not estimated counts as wrong; of an image with n instances of an
object the n surest estimates are taken. Only BOP's detection and the precision of the box look at
all of them (BOP: the 100 surest of an image)."""
CURVE_ENDINGS = (".png", ".pdf", ".svg")


def add_evaluate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `evaluate` to the commands."""
    command = commands.add_parser(
        "evaluate", help="measure estimated poses", description=DESCRIPTION, epilog=EPILOG
    )
    command.set_defaults(command=evaluate)
    command.add_argument("estimates", metavar="ESTIMATES.csv")
    command.add_argument(
        "ground_truth",
        metavar="GROUND_TRUTH",
        help="a CSV file, bop:PATH, linemod:PATH or hmdpose:PATH; with categories a CSV file or "
        "categories",
    )
    command.add_argument("--split", help="of a dataset: which part, if there are several")
    command.add_argument(
        "--targets",
        metavar="FILE",
        help="with bop:PATH: test_targets_bop19.json; of an object's instances the inst_count most "
        "visible are to be found",
    )
    command.add_argument(
        "--visible",
        metavar="F",
        type=float,
        help="with bop:PATH: only poses of which at least this share is visible are to be found, "
        "as BOP's visib_gt_min (default: all, or the targets; of detection 0.1). An estimate of "
        "another pose still is one of the n surest, and wrong; detection and the precision of the "
        "box leave it out",
    )
    command.add_argument(
        "--vsd-delta",
        metavar="MM",
        type=float,
        default=1000 * VSD_DELTA,
        help="of VSD: how far behind the measured depth a surface is visible (default: %(default)g "
        "as BOP has it, but for ITODD 5)",
    )
    command.add_argument(
        "--models",
        metavar="DIR",
        help="folder with models_info.json and obj_000001.ply (default: PATH/models of a dataset; "
        "BOP itself measures with PATH/models_eval where that is)",
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
    command.add_argument(
        "--protocol",
        choices=("paper", "code"),
        help="with categories: what NOCS's paper says (default), or what its public code does, "
        "whose numbers stand in published tables",
    )


def evaluate(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or files that do not fit or are damaged.
        OSError: if a file cannot be read or written.
    """
    if is_category_level(options):
        return evaluate_category_level(options)
    if options.protocol:
        fail("--protocol", "nothing, as the estimates have no categories", options.protocol)
    _check_outputs(options)
    estimates = read_results(options.estimates, rotations=options.rotations)
    truth = read_truth(options)
    wanted = set(truth.poses.object_id.tolist() if options.objects is None else options.objects)
    models = _to_object_models(truth.models, wanted)
    others = truth.present.others
    errors = evaluation.evaluate(
        estimates, truth.poses, models, truth.K, options.objects, truth.images, others
    )
    surface = _surfaces(options, truth, {i: models[i].diameter for i in errors if i in models})
    errors = add_bop_errors(errors, estimates, truth.present, models, truth.images, surface)
    _explain(estimates, truth, models, errors)
    lines = report.report(errors, truth.width)
    time = _time(estimates[evaluation.in_images(estimates, truth.images)])
    curve = None
    if options.curve:
        curve = _draw(errors, Path(options.curve).suffix[1:].lower())
    # Before anything is printed: whoever reads the table may stop at its first line.
    if options.json:
        write_bytes(Path(options.json), _to_json(lines, time))
    if curve is not None:
        write_bytes(Path(options.curve), curve)
    text = report.to_text(lines)
    if time is not None:
        text += f"\n\ntime of an image, mean of {time[1]}: {time[0]:.3f} s"
    say_beside(text, (options.json, options.curve))


def _check_outputs(options: argparse.Namespace) -> None:
    """Refuse what could not be written in the end, before all the work."""
    files = {"--curve": options.curve, "--json": options.json}
    truth, kind = options.ground_truth, kind_of(options.ground_truth)
    inputs = [options.estimates, truth if kind is None else truth[len(kind) + 1 :], options.models]
    inputs += [options.camera, options.targets]
    if options.models:
        inputs.append(str(Path(options.models).resolve().parent / "camera.json"))
    check_outputs(files, inputs)
    if options.curve and Path(options.curve).suffix.lower() not in CURVE_ENDINGS:
        fail("--curve", "a file that ends in " + ", ".join(CURVE_ENDINGS), options.curve)


def _to_object_models(models: ModelSet, wanted: set[int]) -> dict[int, ObjectModel]:
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
        result[object_id] = ObjectModel(
            object_id,
            points,
            info.diameter,
            centre=info.minimum + info.size / 2,
            size=info.size,
            symmetries=symmetries if len(symmetries) > 1 else None,
        )
    return result


def _surfaces(
    options: argparse.Namespace, truth: Truth, diameters: dict[int, float]
) -> DatasetSurfaces | None:
    """What measures VSD, where there are depth images and models with faces."""
    delta = require_number("--vsd-delta", options.vsd_delta, 0) / 1000
    if truth.dataset is None:
        if diameters:
            note(f"no VSD and no AR, which need depth images: {truth.without_depth}")
        return None
    surface = DatasetSurfaces(truth.dataset, truth.models, diameters, delta)
    if bare := sorted(set(diameters) - surface.object_ids):
        note(f"no VSD and no AR of objects {bare}: their meshes have no faces")
    return surface


def _time(estimates: PoseTable) -> tuple[float, int] | None:
    """Seconds of an image on average, and of how many."""
    try:
        return bop_scores.time_per_image(estimates)
    except ValueError as error:
        note(f"no time of an image: {error}")
        return None


def _explain(
    estimates: PoseTable,
    truth: Truth,
    models: dict[int, ObjectModel],
    errors: dict[int, evaluation.ObjectErrors],
) -> None:
    """Say what was left out, and what looks odd."""
    ids = list(errors)
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
    held = {*_keys(poses), *_keys(truth.present.others)}
    mine = np.isin(estimates.object_id, ids) & ~foreign
    if lost := sum(key not in held for key in _keys(estimates[mine])):
        note(
            f"{lost} of the estimates are of objects that their image does not hold: precision of "
            "the box pays for them, BOP's detection leaves them out"
        )
    for name, table in (("estimates", estimates), ("ground truth", poses)):
        table = table[np.isin(table.object_id, ids)]
        improper = ~rotations.is_rotation(table.R)
        if improper.any():
            note(
                f"{improper.sum()} of {len(table)} matrices of the {name} are not rotations: no "
                f"angles and boxes of objects {np.unique(table.object_id[improper]).tolist()} "
                "(--rotations project takes the nearest rotations)"
            )
    if (hidden := [one.in_front for one in errors.values() if one.in_front is not None]) and (
        count := int(np.sum([(~mask).sum() for mask in hidden]))
    ):
        note(
            f"{count} of {sum(map(len, hidden))} true poses are not all in front of the camera: "
            "they are left out of whatever is measured in pixels"
        )
    diameters = {i: model.diameter for i, model in models.items()}
    for text in units.of_tables({"estimates": estimates, "ground truth": poses}, diameters):
        note(text)


def _keys(table: PoseTable) -> list[tuple[int, int, int]]:
    """Scene, image and object of every row."""
    ids = table.object_id.tolist()
    return [(*image, object_id) for image, object_id in zip(table.images, ids, strict=True)]


def _to_json(lines: list[report.Line], time: tuple[float, int] | None) -> bytes:
    def number(value: float | None) -> float | None:
        return value if value is not None and np.isfinite(value) else None  # JSON has no infinity

    content: dict = {}
    for line in lines:
        content.setdefault(line.section, {})[line.label] = {
            "objects": {i: number(value) for i, value in line.objects.items()},
            "all poses": number(line.pooled),
            "mean of objects": number(line.mean),
        }
    if time is not None:
        content["time"] = {"seconds of an image": {"mean": time[0], "images": time[1]}}
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def _draw(errors: dict[int, evaluation.ObjectErrors], kind: str) -> bytes:
    from posecore import figures  # all else does without matplotlib

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
