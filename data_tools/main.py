"""The command line: `python -m data_tools make | show | export | check | models_info | clean`."""

from __future__ import annotations

import argparse
import importlib
import itertools
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from data_tools import models_info, storage, units, views
from data_tools.bop.files import read_json
from data_tools.bop.writing import write_dataset
from data_tools.worlds.world import World
from posecore.arrays import fail, require_choice, require_integer
from posecore.command_line import carry_out, note, refuse_empty
from posecore.files import write_bytes
from posecore.scale import SCALES

__all__ = ["main", "parse", "run"]

WORLDS = ("headset", "tabletop", "categories")
# Not "train_pbr": there the toolkit looks for JPEG files, in which colours are not as they were.
PARTS = {"train": "train", "easy": "test", "occluded": "test_occluded"}
PICTURE = re.compile(r"[0-9]+(_\w+)?")  # names of a dataset's pictures and masks


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, or 1 with one line that says what is wrong.

    After an interrupt from the keyboard it is 130, as everywhere.

    Args:
        arguments: what follows the program's name; None for what it was called with.
    """
    return run(parse(arguments))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of the command line; ends the process with 2 for what is no command."""
    return _parser().parse_args(arguments)


def run(options: argparse.Namespace) -> int:
    """Run a command of the command line; returns the exit status, as `main` does."""

    def command() -> int | None:
        refuse_empty(options, "world", "source", "path")
        return options.command(options)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: note(str(message))
        return carry_out(
            command,
            stopped="stopped; finished files of worlds are kept",
            refusals=(ValueError, OSError, RuntimeError),
        )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m data_tools", description="Worlds of images with exact poses."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    make = _command(commands, "make", _make, "make what is missing of a world")
    _add_world(make)
    make.add_argument("--processes", type=int, help="default: one on each core")
    make.add_argument(
        "--shard",
        metavar="i/n",
        default="1/1",
        help="make the i-th of n parts, to divide the work among machines",
    )
    make.add_argument("--quiet", action="store_true", help="no progress bar")

    show = _command(commands, "show", _show, "draw views with their poses into a PNG file")
    show.add_argument("source", help="a world, bop:PATH, linemod:PATH or hmdpose:PATH")
    _add_split_and_scale(show)
    show.add_argument("--count", type=int, default=12, help="views (default: 12)")
    show.add_argument("--first", type=int, default=0, help="index of the first view (default: 0)")
    show.add_argument("--output", metavar="FILE.png", help="default: SOURCE_SPLIT.png")

    export = _command(commands, "export", _export, "write a world as others lay out datasets")
    export.add_argument("path", help="a new folder")
    export.add_argument(
        "--world",
        choices=("tabletop", "headset"),
        default="tabletop",
        help="tabletop, the default, as a BOP dataset; headset for hmdpose:PATH",
    )
    export.add_argument("--scale", choices=SCALES, help="default: POSECORE_SCALE")
    export.add_argument(
        "--count", type=int, help="views of each split, of headset triples (default: all)"
    )

    check = _command(
        commands,
        "check",
        _check,
        "read all files of a world, or say what is off in an own dataset; exit 1 if anything is",
    )
    check.add_argument(
        "source", nargs="+", help="a world, or a dataset: bop:PATH, PATH for the same, linemod:PATH"
    )
    _add_split_and_scale(check)
    check.add_argument("--count", type=int, default=30, help="images of a dataset (default: 30)")
    check.add_argument(
        "--pictures", metavar="FOLDER", help="draw masks and models of a dataset over its images"
    )

    text = "measure own meshes, and test the symmetries they are said to have"
    models_info.add_options(_command(commands, "models_info", models_info.models_info, text))

    _command(commands, "clean", _clean, "delete all made worlds, and say how much it was")
    return parser


def _command(commands: Any, name: str, function: Any, text: str) -> argparse.ArgumentParser:
    command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    command.set_defaults(command=function)
    return command


def _add_world(command: argparse.ArgumentParser) -> None:
    command.add_argument("world", nargs="+", help=", ".join(WORLDS))
    _add_split_and_scale(command)


def _add_split_and_scale(command: argparse.ArgumentParser) -> None:
    command.add_argument("--split", help="default: all, or the first")
    command.add_argument("--scale", choices=SCALES, help="default: POSECORE_SCALE")


def _world(name: str) -> World:
    require_choice("world", name, WORLDS)
    return importlib.import_module(f"data_tools.worlds.{name}").WORLD


def _stores(options: argparse.Namespace) -> list[storage.Store]:
    """The stores of the splits that were asked for."""
    stores = []
    for name in options.world:
        world = _world(name)
        for split in world.splits if options.split is None else [options.split]:
            stores.append(world.store(split, options.scale))
    return stores


def _part(text: str) -> tuple[int, int]:
    i, _, n = text.partition("/")
    if not (
        re.fullmatch("[0-9]{1,9}", i) and re.fullmatch("[0-9]{1,9}", n) and 1 <= int(i) <= int(n)
    ):
        fail("--shard", "i/n, the i-th of n parts, such as 1/4", repr(text))
    return int(i), int(n)


def _make(options: argparse.Namespace) -> None:
    part = _part(options.shard)
    for store in _stores(options):
        made = store.make(options.processes, part=part, progress=not options.quiet)
        print(f"{store.folder}: {made} of {store.shards} files made")


def _show(options: argparse.Namespace) -> None:
    split, choices = options.split, {}
    name = options.source.partition(":")[0]
    if options.source in WORLDS:
        split = split or _world(options.source).splits[0]
        choices = {"scale": options.scale, "whole": False}
    elif options.scale:
        fail("--scale", "a world to go with it", options.source)
    dataset = views.open(options.source, split=split, **choices)
    for text in units.of_dataset(dataset):
        note(f"{options.source}: {text}")
    path = Path(options.output or (f"{name}_{split}.png" if split else f"{name}.png"))
    if path.suffix != ".png":
        fail("--output", "a name that ends in .png", str(path))
    folder = options.source.partition(":")[2]
    if folder and path.is_file() and Path(folder).resolve() in path.resolve().parents:
        if PICTURE.fullmatch(path.stem):
            fail("--output", "a file that is none of the dataset's", str(path))
    first = require_integer("--first", options.first, 0, len(dataset) - 1)
    count = require_integer("--count", options.count, 1)
    chosen = [dataset[i] for i in range(first, min(first + count, len(dataset)))]
    write_bytes(path, _contact_sheet(chosen))
    print(path)


def _contact_sheet(chosen: Sequence[views.View]) -> bytes:
    """The views side by side, with the poses of their objects, as a PNG file."""
    from posecore import figures  # the other commands do without matplotlib
    from posecore.figures.style import BOX_COLOURS

    images = [next(i for i in (v.rgb, v.ir, v.depth) if i is not None) for v in chosen]
    titles = [f"{view.scene_id}/{view.image_id}" for view in chosen]
    columns = min(4, len(chosen))
    sheet = figures.picture_grid(images, titles, columns=columns, width=6.0 * columns)
    for axes, view in zip(sheet.axes, chosen, strict=False):
        for item in view.objects:
            if item.mask is not None and not item.mask.any():
                continue
            length = 0.05
            if item.size is not None:
                colour = BOX_COLOURS[item.object_id % len(BOX_COLOURS)]
                figures.draw_box(axes, view.K, item.R, item.t, item.size, colour=colour)
                length = item.size.max() / 3
            figures.draw_axes(axes, view.K, item.R, item.t, length)
    return sheet.png()


def _export(options: argparse.Namespace) -> None:
    if options.count is not None:
        require_integer("--count", options.count, 1)
    (_export_headset if options.world == "headset" else _export_tabletop)(options)
    print(options.path)


def _export_headset(options: argparse.Namespace) -> None:
    from data_tools.hmdpose import write_hmdpose

    world = _world("headset")
    count = None if options.count is None else options.count * world.views_per_record
    parts: dict[str, Iterator[views.View]] = {}
    for split in world.splits:
        dataset = world.open(split=split, scale=options.scale, whole=count is None)
        parts[split] = itertools.islice(dataset, count)
    models = world.models
    write_hmdpose(
        parts,
        options.path,
        {i: models.mesh(i) for i in models.ids},
        infos={i: models.info(i) for i in models.ids},
    )


def _export_tabletop(options: argparse.Namespace) -> None:
    from data_tools.worlds import tabletop

    models = tabletop.WORLD.models
    parts: dict[str, Iterator[views.View]] = {}
    for split, name in PARTS.items():
        whole = options.count is None
        dataset = tabletop.WORLD.open(split=split, scale=options.scale, whole=whole)
        parts[name] = itertools.islice(dataset, options.count)
    write_dataset(
        parts,
        options.path,
        {i: models.mesh(i) for i in models.ids},
        infos={i: models.info(i) for i in models.ids},
        silhouettes=tabletop.silhouettes,
        depth_scale=tabletop.DEPTH_SCALE,
    )


def _check(options: argparse.Namespace) -> int:
    from data_tools.checking import command  # the other commands do without it

    options.world = [name for name in options.source if name in WORLDS]
    sources = [command.source_of(name) for name in options.source if name not in WORLDS]
    for name in sources:
        if ":" not in name:
            fail("source", f"one of {', '.join(WORLDS)}, a folder or KIND:PATH", repr(name))
    if sources and options.scale:
        fail("--scale", "a world to go with it", sources[0])
    if options.world and options.pictures:
        fail("--pictures", "a dataset to go with it", options.world[0])
    bad = _check_worlds(options)
    for source in sources:
        bad |= command.check_source(source, options.split, options.count, options.pictures)
    return bad


def _check_worlds(options: argparse.Namespace) -> bool:
    problems = []
    for store in _stores(options):
        found = store.check()
        print(f"{store.folder}: {store.shards - len(found)} of {store.shards} files are good")
        problems += found
        # It is there for those who look into the folder; nothing is read from it.
        if (recipe := store.folder / "recipe.json").is_file():
            try:
                read_json(recipe)
            except (ValueError, OSError) as error:
                problems.append(f"{error}; it is written again once it is deleted")
    for line in problems:
        print(line, file=sys.stderr)
    return bool(problems)


def _clean(options: argparse.Namespace) -> None:
    sizes, left = storage.clean()
    for world, size in sizes.items():
        print(f"{size / 1e6:10.1f} MB  {world}")
    print(f"{sum(sizes.values()) / 1e6:10.1f} MB deleted")
    if left:
        print(f"left alone: {len(left)} files that are none of ours, such as {left[0]}")
