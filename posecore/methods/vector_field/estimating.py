"""`estimate vector_field`: from the images of a dataset to a results file."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from tqdm.auto import tqdm

from data_tools.bop import write_results
from posecore.arrays import fail
from posecore.methods.sources import open_source
from posecore.methods.vector_field.runs import read_run
from posecore.methods.vector_field.systems import SYSTEMS, Estimate, VectorFieldSystem
from posecore.metrics.pose_table import PoseTable
from posecore.training.machine import choose_device

__all__ = ["estimate"]


def estimate(options: argparse.Namespace) -> None:
    """Run the command.

    Raises:
        ValueError: for an option that cannot be, or a run or data that do not fit.
        OSError: if the results cannot be written.
    """
    output = Path(options.output)
    if not output.resolve().parent.is_dir():
        fail("--output", "a file in a folder that exists", options.output)
    run = read_run(options.run)
    choices = {}
    if options.targets:
        if not options.data.startswith("bop:"):
            fail("--targets", "nothing, as the data are no bop:PATH", options.targets)
        choices["targets"] = options.targets
    dataset = open_source(options.data, options.split, run.options.get("scale"), **choices)
    ids = [model.object_id for model in run.models]
    if dataset.object_ids and not set(ids) & set(dataset.object_ids):
        fail("--data", f"data with one of the run's objects {ids}", list(dataset.object_ids))
    device = choose_device(options.device)
    net, refiner = run.new_net(), None
    run.load_weights("net", net)
    if SYSTEMS[options.system] != "never":
        refiner = run.new_refiner()
        run.load_weights("refiner", refiner)
        refiner.to(device)
    system = VectorFieldSystem.named(
        options.system, net.to(device, memory_format=torch.channels_last), run.models, refiner,
        threshold=options.threshold, seed=options.seed,
    )  # fmt: skip
    rows, seconds = [], []
    for view in tqdm(dataset, desc="estimates", total=len(dataset), disable=None):
        if view.rgb is None:
            fail("--data", "data with colour images", f"{view} in {options.data}")
        image = torch.from_numpy(view.rgb).permute(2, 0, 1)[None].float() / 255
        began = time.perf_counter()
        found = system.estimate(image, view.K)
        seconds.append(time.perf_counter() - began)
        rows += [(view.scene_id, view.image_id, seconds[-1], item) for item in found]
    write_results(output, _table(rows))
    spent = f", {1000 * np.median(seconds):.0f} ms an image (median)" if seconds else ""
    print(f"{output}: {len(rows)} poses in {len(seconds)} images{spent}")


def _table(rows: list[tuple[int, int, float, Estimate]]) -> PoseTable:
    scene_id, image_id, seconds, found = zip(*rows, strict=True) if rows else ((),) * 4
    return PoseTable(
        scene_id=np.array(scene_id, np.int64),
        image_id=np.array(image_id, np.int64),
        object_id=np.array([item.object_id for item in found], np.int64),
        R=np.reshape([item.R for item in found], (-1, 3, 3)),
        t=np.reshape([item.t for item in found], (-1, 3)),
        score=np.array([item.score for item in found], np.float64),
        time=np.array(seconds, np.float64),
    )
