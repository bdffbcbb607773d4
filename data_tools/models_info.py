"""The command `models_info`: what BOP's `models_info.json` says of one's own meshes."""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import trimesh

from data_tools import units
from data_tools.bop.files import has_file, has_folder
from data_tools.bop.measuring import Measured, Symmetry, measure_model
from data_tools.bop.meshes import MESH_SUFFIXES, read_mesh
from data_tools.bop.model_writing import to_models_info, write_models
from data_tools.bop.models import ModelInfo, _find_meshes
from data_tools.storage.folders import new_folder
from posecore.arrays import fail, require_integer, require_number
from posecore.command_line import note
from posecore.files import require_path, write_bytes

__all__ = ["EXAMPLES", "UNITS", "add_options", "models_info"]

UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
"""Metres of what the coordinates of a mesh may count."""
OTHERS = (".txt", ".csv", ".yml", ".yaml", ".xyz", ".pcd")  # which are no names of folders
NOTICEABLE = 0.02  # share of the diameter, beyond which a stated symmetry gets a note
EXAMPLES = """\
symmetries, as often as there are any:
  --symmetry z:4                  the same after quarter turns about z
  --symmetry z:continuous         a solid of revolution: any turn about z
  --symmetry 1,1,0:2@0,0,12.5     half a turn about a direction, through a point of the mesh
  --symmetry 5=z:2                of object 5 only

python -m data_tools models_info mug.obj --unit m --symmetry z:2 --output models
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Give a command its options and examples."""
    command.formatter_class = argparse.RawDescriptionHelpFormatter
    command.epilog = EXAMPLES
    command.add_argument(
        "path", nargs="+", help="meshes (.ply, .obj, .stl), or a folder with obj_000001.ply, ..."
    )
    command.add_argument(
        "--unit", choices=UNITS, default="mm", help="of their coordinates (default: mm, as in BOP)"
    )
    command.add_argument(
        "--id", type=int, help="object id of a single mesh that is not called obj_ID (default: 1)"
    )
    command.add_argument(
        "--symmetry",
        action="append",
        default=[],
        metavar="[ID=]AXIS:FOLD[@X,Y,Z]",
        help="see below; (X, Y, Z) in the mesh's unit (default: its origin)",
    )
    command.add_argument(
        "--tolerance",
        type=float,
        default=0.1,
        help="share of the diameter by which a symmetry may move the surface (default: 0.1)",
    )
    command.add_argument(
        "--output",
        metavar="FILE.json|FOLDER",
        help="a new file; or a new folder: the meshes as BOP has them, PLY in mm, and the list "
        "(default: print the list)",
    )


def models_info(options: argparse.Namespace) -> None:
    """Measure meshes, and print or write what is known of them.

    Raises:
        ValueError: naming the option or the file at fault; nothing is written then.
        OSError: if a file cannot be read or written.
    """
    output = _output(options.output)
    tolerance = require_number("--tolerance", options.tolerance, above=0)
    unit = UNITS[options.unit]
    files = _files(options.path, options.id)
    stated = _stated(options.symmetry, files, unit)
    meshes = {object_id: _read(file, unit) for object_id, file in files.items()}
    infos = {}
    for object_id, mesh in meshes.items():
        named = stated[object_id]
        found = _measure(object_id, mesh, named, tolerance, unit)
        infos[object_id] = found.info
        if output is not None:
            print(_described(files[object_id], object_id, found.info))
            for line in _symmetries(named, found):
                print(f"  {line}")
        for name, check in zip([*named, "these together"], found.checks, strict=False):
            if check.largest > NOTICEABLE:
                note(
                    f"object {object_id}: {name} moves points of the surface by up to "
                    f"{100 * check.largest:.2g} % of the diameter: look whether it is symmetric"
                )
    for text in units.of_tables({}, {i: info.diameter for i, info in infos.items()}):
        note(text.replace(units.HINT, f"its mesh was read in {options.unit}, see --unit"))
    shapes = [str(file) for file in files.values() if file.suffix.lower() != ".ply"]
    if output is not None and output.suffix != ".json" and shapes:
        note(f"of {', '.join(shapes)} the shape is written, colours and textures are not")
    _write(output, meshes, infos, options.unit)


def _output(name: str | None) -> Path | None:
    """Where to write, refused before anything is measured."""
    if name is None:
        return None
    output = require_path("--output", name)
    if output.suffix.lower() in (*MESH_SUFFIXES, *OTHERS):
        fail("--output", "a file that ends in .json, or a folder", name)
    # Symmetries that somebody stated are not to be lost.
    if output.suffix == ".json" and output.exists():
        fail("--output", "a new file", f"{name}, which is there")
    if output.is_file() or (output.is_dir() and any(output.iterdir())):
        fail("--output", "a new or an empty folder", name)
    if not output.absolute().parent.is_dir():
        fail("--output", "a place in a folder that exists", name)
    return output


def _files(paths: Sequence[str], object_id: int | None) -> dict[int, Path]:
    """The mesh of each object; names say which one it is."""
    files: dict[int, Path] = {}
    if object_id is not None:
        require_integer("--id", object_id, 0)
        if len(paths) != 1 or has_folder(Path(paths[0])):
            fail("--id", "a single mesh to go with it", ", ".join(paths))
        return {object_id: _require_mesh(Path(paths[0]))}
    for path in map(Path, paths):
        if has_folder(path):
            found = _find_meshes(path)
            if not found:
                names = "obj_000001.ply, obj_000002.ply, ... (or .obj, .stl)"
                fail("path", f"a folder with meshes called {names}", str(path))
        else:
            named = re.fullmatch("obj_([0-9]{1,18})", _require_mesh(path).stem)
            if named is None and len(paths) > 1:
                fail("path", "several meshes called obj_000001.ply, obj_000002.ply, ...", str(path))
            if named is None:
                note(f"{path} counts as object 1, see --id")
            found = {1 if named is None else int(named[1]): path}
        for i, file in sorted(found.items()):
            if i in files:
                fail("path", "one mesh of each object", f"{files[i]} and {file} of object {i}")
            files[i] = file
    return dict(sorted(files.items()))


def _require_mesh(path: Path) -> Path:
    if path.suffix.lower() not in MESH_SUFFIXES:
        fail("path", f"a mesh that ends in {', '.join(MESH_SUFFIXES)}, or a folder", str(path))
    if not has_file(path):
        raise FileNotFoundError(2, "no such mesh", str(path))
    return path


def _read(file: Path, unit: float) -> trimesh.Trimesh:
    """A mesh in metres; files are read as millimetres."""
    mesh = read_mesh(file)
    if unit != UNITS["mm"]:
        mesh.vertices = mesh.vertices * (unit / UNITS["mm"])
    return mesh


def _stated(
    texts: Sequence[str], files: Mapping[int, Path], unit: float
) -> dict[int, dict[str, Symmetry]]:
    """The symmetries of each object, by how they were stated."""
    stated: dict[int, dict[str, Symmetry]] = {object_id: {} for object_id in files}
    for text in texts:
        object_id, _, motion = text.rpartition("=")
        chosen = list(files)
        if object_id:
            if not re.fullmatch("[0-9]{1,18}", object_id) or int(object_id) not in files:
                ids = ", ".join(map(str, files))
                fail(f"--symmetry {text}", f"an object of {ids} before =", repr(object_id))
            chosen = [int(object_id)]
        elif len(files) > 1:
            example = f"--symmetry {chosen[0]}={motion}"
            fail(f"--symmetry {text}", f"which object it is of, such as {example}", "none")
        try:
            stated[chosen[0]][motion] = Symmetry.parse(motion, unit)
        except ValueError as error:
            raise ValueError(f"--symmetry {text}: {error}") from error
    return stated


def _measure(
    object_id: int,
    mesh: trimesh.Trimesh,
    stated: Mapping[str, Symmetry],
    tolerance: float,
    unit: float,
) -> Measured:
    symmetries = list(stated.values())
    try:
        return measure_model(mesh, symmetries, tolerance)
    except ValueError as error:
        text = str(error)
        number = re.match(r"symmetries\[([0-9]+)\]", text)
        if number is None:
            raise ValueError(f"object {object_id}: {text}") from error
        name = list(stated)[int(number[1])]
        text = f"--symmetry {name}{text[number.end() :]}"
        # The commonest mistake: the object is symmetric, but not about its origin.
        middle = (mesh.bounds[0] + mesh.bounds[1]) / 2
        centred = dataclasses.replace(stated[name], offset=middle)
        if (middle != stated[name].offset).any() and _fits(mesh, centred, tolerance):
            place = ",".join(f"{x / unit:.6g}" for x in middle)
            text += f"; about the middle of its box they are: {name.partition('@')[0]}@{place}"
        else:
            text += "; --tolerance allows more"
        raise ValueError(f"object {object_id}: {text}") from error


def _fits(mesh: trimesh.Trimesh, symmetry: Symmetry, tolerance: float) -> bool:
    try:
        measure_model(mesh, [symmetry], tolerance)
    except ValueError:
        return False
    return True


def _described(file: Path, object_id: int, info: ModelInfo) -> str:
    size = " x ".join(f"{1000 * length:.6g}" for length in info.size)
    low = ", ".join(f"{1000 * x:.6g}" for x in info.minimum)
    return (
        f"object {object_id}: {file}: diameter {1000 * info.diameter:.6g} mm, box {size} mm "
        f"from ({low})"
    )


def _symmetries(names: Mapping[str, Symmetry], found: Measured) -> list[str]:
    """What is listed, and how well it fits."""
    lines = [
        f"{name}: moves points of the surface by up to {100 * check.largest:.2g} % of the diameter"
        for name, check in zip(names, found.checks, strict=False)
    ]
    discrete, continuous = found.info.symmetries_discrete, found.info.symmetries_continuous
    if names:
        lines.append(f"listed: {len(discrete)} discrete, {len(continuous)} continuous symmetries")
    return lines


def _write(
    output: Path | None,
    meshes: Mapping[int, trimesh.Trimesh],
    infos: Mapping[int, ModelInfo],
    unit: str,
) -> None:
    if output is not None and output.suffix != ".json":
        with new_folder(output) as unfinished:
            write_models(unfinished, meshes, infos)
        print(output)
        return
    if unit != "mm":
        note(f"the list is in mm, as in BOP; the meshes, in {unit}, are not: --output FOLDER")
    if output is None:
        print(to_models_info(infos).decode(), end="")
    else:
        write_bytes(output, to_models_info(infos))
        print(output)
