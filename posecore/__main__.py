"""The command line: `python -m posecore evaluate ESTIMATES.csv GROUND_TRUTH --models DIR`."""

from __future__ import annotations

import argparse
import io
import json
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

# The one module of posecore that may know data_tools: it joins files with metrics.
import data_tools
from data_tools.bop import Models, read_results
from data_tools.bop.files import read_json, read_number, write_bytes
from posecore import figures, rotations
from posecore.arrays import fail
from posecore.metrics import evaluation, report
from posecore.metrics.pose_table import PoseTable

__all__ = ["main"]

DESCRIPTION = """Measure estimated poses against ground truth with every metric of the field.
Estimates are a CSV file in the BOP format (scene_id,im_id,obj_id,score,R,t,time; millimetres);
ground truth is such a file too, or bop:PATH, the folder of a BOP dataset. A pose that was not
estimated counts as wrong; of an image with n instances of an object the n surest estimates are
taken."""
CURVE_ENDINGS = (".png", ".pdf", ".svg")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, or 2 for input that cannot be used."""
    options = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: _note(str(message))
        try:
            options.command(options)
        except (ValueError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m posecore", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser(
        "evaluate", help="measure estimated poses with every metric", description=DESCRIPTION
    )
    command.set_defaults(command=_evaluate)
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
        "or the numbers as they are, to reproduce others' figures",
    )
    command.add_argument("--objects", metavar="ID", type=int, nargs="+", help="default: all")
    command.add_argument(
        "--curve", metavar="FILE", help="draw the accuracy curve of ADD(-S): .png, .pdf or .svg"
    )
    command.add_argument("--json", metavar="FILE", help="write all values, unrounded")
    return parser


def _evaluate(options: argparse.Namespace) -> None:
    if options.curve and Path(options.curve).suffix not in CURVE_ENDINGS:
        fail("--curve", "a file that ends in " + ", ".join(CURVE_ENDINGS), options.curve)
    estimates = read_results(options.estimates, rotations=options.rotations)
    is_dataset = options.ground_truth.startswith("bop:")
    truth, models, K, width = (_from_dataset if is_dataset else _from_files)(options)
    errors = evaluation.evaluate(estimates, truth, models, K, options.objects)
    lines = report.report(errors, width)
    _explain(estimates, truth, models, list(errors))
    print(report.to_text(lines))
    if options.json:
        write_bytes(Path(options.json), _to_json(lines))
    if options.curve:
        write_bytes(Path(options.curve), _draw(errors, Path(options.curve).suffix[1:]))


Truth = tuple[PoseTable, dict[int, evaluation.ObjectModel], np.ndarray | None, float]
"""Ground truth, models, intrinsics (3, 3) or (G, 3, 3), and the images' width in pixels."""


def _from_dataset(options: argparse.Namespace) -> Truth:
    if options.camera:
        fail("--camera", "nothing, as every image of bop:PATH has a camera", options.camera)
    dataset = data_tools.open(
        options.ground_truth,
        split=options.split,
        targets=options.targets,
        rotations=options.rotations,
    )
    truth = dataset.ground_truth()
    images = zip(truth.scene_id.tolist(), truth.image_id.tolist(), strict=True)
    K = np.reshape([dataset.camera(*image).K for image in images], (-1, 3, 3))
    models = Models(options.models) if options.models else dataset.models()
    shape = dataset[0].shape if len(dataset) else None
    return truth, _to_object_models(models), K, float(shape[1] if shape else 640)


def _from_files(options: argparse.Namespace) -> Truth:
    if not options.models:
        fail("--models", "a folder of models", "none")
    for name in ("split", "targets"):
        if getattr(options, name):
            fail(f"--{name}", "nothing, as the ground truth is no bop:PATH", getattr(options, name))
    truth = read_results(options.ground_truth, rotations=options.rotations)
    models = _to_object_models(Models(options.models))
    return truth, models, *_read_camera(options.camera, Path(options.models))


def _to_object_models(models: Models) -> dict[int, evaluation.ObjectModel]:
    result = {}
    for object_id in models.ids:
        info = models.info(object_id)
        symmetries = info.symmetries()
        result[object_id] = evaluation.ObjectModel(
            points=models.mesh(object_id).vertices,
            diameter=info.diameter,
            centre=info.minimum + info.size / 2,
            size=info.size,
            symmetries=symmetries if len(symmetries) > 1 else None,
        )
    return result


def _read_camera(file: str | None, models: Path) -> tuple[np.ndarray | None, float]:
    """K (3, 3) and the width of the images; None and 640 without a camera file."""
    path = Path(file) if file else models.resolve().parent / "camera.json"
    if not file and not path.is_file():
        _note(f"no {path}, so no errors in pixels (--camera names another)")
        return None, 640.0
    camera = read_json(path)
    fx, fy, cx, cy = (read_number(str(path), camera, name) for name in ("fx", "fy", "cx", "cy"))
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), read_number(str(path), camera, "width")


def _explain(
    estimates: PoseTable,
    truth: PoseTable,
    models: dict[int, evaluation.ObjectModel],
    ids: list[int],
) -> None:
    """Say what was left out, and why."""
    bare = [i for i in ids if i not in models]
    if bare:
        _note(f"no model of objects {bare}: for them only errors of rotation and translation")
    strangers = sorted(set(estimates.object_id.tolist()) - set(truth.object_id.tolist()))
    if strangers:
        _note(f"estimates of objects {strangers} are ignored: the ground truth holds none")
    for name, table in (("estimates", estimates), ("ground truth", truth)):
        improper = int((~rotations.is_rotation(table.R)).sum())
        if improper:
            _note(
                f"{improper} of {len(table)} matrices of the {name} are not rotations: no errors "
                "of angles or boxes (--rotations project takes the nearest rotations)"
            )


def _to_json(lines: list[report.Line]) -> bytes:
    content: dict = {}
    for line in lines:
        content.setdefault(line.section, {})[line.label] = {
            "objects": line.objects,
            "all poses": line.pooled,
            "mean of objects": line.mean,
        }
    return (json.dumps(content, indent=1) + "\n").encode()


def _draw(errors: dict[int, evaluation.ObjectErrors], kind: str) -> bytes:
    curves = {
        f"object {i}": one.values["add_or_s"]
        for i, one in errors.items()
        if "add_or_s" in one.values
    }
    if not curves:
        fail("--curve", "at least one object with a model", "none")
    if len(curves) > 1:
        curves["all poses"] = np.concatenate(list(curves.values()))
    figure = figures.accuracy_curves(curves, name="ADD(-S)")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=150)
    return buffer.getvalue()


def _note(text: str) -> None:
    print(f"note: {text}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
