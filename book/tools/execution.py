"""Pages run from a clean start, their outputs stored without what belongs to one machine or day."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Empty
from typing import Any

from ipykernel.kernelspec import RESOURCES, get_kernel_dict
from jupyter_client.asynchronous import AsyncKernelClient
from jupyter_client.channels import AsyncZMQSocketChannel
from jupyter_client.kernelspec import KernelSpec, KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from nbformat import NotebookNode
from traitlets import Type

from book.tools.contents import ROOT, find_page
from book.tools.inputs import inputs
from book.tools.notebooks import (
    code_digest,
    notebook_bytes,
    outputs_digest,
    read_source,
    with_outputs,
    write_notebook,
)
from book.tools.pairs import refuse_lost_edits, set_aside
from book.tools.variables import variables
from posecore.arrays import require_choice
from posecore.scale import SCALES

__all__ = [
    "CELL_TIMEOUT",
    "STARTUP_TIMEOUT",
    "clean_outputs",
    "environment",
    "execute",
]

CELL_TIMEOUT = 1800
"""Seconds that one cell of a page may take at `book` scale; it may have to make a world first."""
STARTUP_TIMEOUT = 120

WIDGET_VIEW = "application/vnd.jupyter.widget-view+json"
WIDGET_STATE = "application/vnd.jupyter.widget-state+json"
REFERENCE = "IPY_MODEL_"
PROGRESS = re.compile(r"^.*\d+%\|.*\| .*\[.*\].*$|^.*\d+(?:it|B)? \[\d+:\d\d, .*\].*$")
ESCAPE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")


def execute(path: Path, scale: str = "book") -> NotebookNode:
    """Run a page from its source in a new kernel and store what it shows in the notebook beside it.

    The kernel is this Python, in the page's folder. A run that fails leaves the old notebook.

    Args:
        path: either side of the pair.
        scale: what `POSECORE_SCALE` says to the page.

    Returns:
        The notebook; `metadata.posecore` holds hashes of its code and outputs, and the scale.

    Raises:
        ValueError: if a cell fails or takes too long, if the page's code was changed while it ran,
            or if the notebook holds edits that its source lacks.
    """
    require_choice("scale", scale, SCALES)
    source, target = Path(path).with_suffix(".py"), Path(path).with_suffix(".ipynb")
    nb = read_source(source)
    if target.exists():
        refuse_lost_edits(source, target)
    shown = inputs(nb, find_page(source.stem, source.parent), source.parent)
    _run(nb, source, scale)
    clean_outputs(nb)
    nb.metadata["posecore"] = {
        "code": code_digest(nb),
        "inputs": shown,
        "outputs": outputs_digest(nb),
        "scale": scale,
    }
    now = read_source(source)
    if code_digest(now) != code_digest(nb):
        raise ValueError(f"the code of {source.name} was changed while it ran; run it again")
    nb = with_outputs(now, nb)
    if target.exists():  # somebody may have saved it in these minutes
        refuse_lost_edits(source, target)
    set_aside(target, notebook_bytes(nb))
    write_notebook(nb, target)
    os.utime(source)  # JupyterLab expects a source to be no older than its notebook
    return nb


@contextmanager
def environment(scale: str, profile: Path) -> Iterator[None]:
    """Within it, kernels start the same for everybody: no settings of one user or machine count.

    IPython profiles and start-up files, matplotlib's settings, Python's switches (one of them
    turns assertions off), real data and retraining are kept out; this checkout is imported, not
    another that may be installed.

    Args:
        scale: what `POSECORE_SCALE` says.
        profile: an empty folder for IPython, which is there as long as the kernels.
    """
    matplotlib = importlib.util.find_spec("matplotlib")
    changes = {
        "POSECORE_SCALE": scale,
        "POSECORE_DATA": None,
        "POSECORE_RETRAIN": None,
        "IPYTHONDIR": str(profile),
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
        "MATPLOTLIBRC": str(Path(matplotlib.origin).parent / "mpl-data" / "matplotlibrc"),
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])),
        "PYTHONSTARTUP": None,
        "PYTHONOPTIMIZE": None,
        "PYTHONWARNINGS": None,
    }
    with variables(changes):
        yield


class _ThisPython(KernelSpecManager):
    """Knows one kernel: this Python, whatever kernels are installed under that name."""

    def get_kernel_spec(self, kernel_name: str) -> KernelSpec:
        return KernelSpec(resource_dir=RESOURCES, **get_kernel_dict())


class _Channel(AsyncZMQSocketChannel):
    """Looks for a reply once a second, whatever it is told.

    A widget makes nbclient send on the socket on which it waits, and ZeroMQ may take the sending
    for the news that a reply is there (nbclient's issue 312): the reply then lies unread until the
    cell's time is over.
    """

    async def get_msg(self, timeout: float | None = None) -> dict[str, Any]:
        end = float("inf") if timeout is None else time.monotonic() + timeout
        while True:
            left = max(0.0, end - time.monotonic())
            try:
                return await super().get_msg(min(left, 1.0))
            except Empty:
                if left <= 1.0:
                    raise


class _Client(AsyncKernelClient):
    shell_channel_class = Type(_Channel)


class _Kernel(AsyncKernelManager):
    def _kernel_spec_manager_default(self) -> KernelSpecManager:
        return _ThisPython()

    def _client_factory_default(self) -> type[AsyncKernelClient]:
        return _Client


def _run(nb: NotebookNode, source: Path, scale: str) -> None:
    """Fill a notebook with the outputs of its run."""
    client = NotebookClient(
        nb,
        kernel_manager_class=_Kernel,  # given a manager, it would leave the kernel running
        timeout=CELL_TIMEOUT,
        startup_timeout=STARTUP_TIMEOUT,
        resources={"metadata": {"path": str(source.parent.resolve())}},
    )
    running = {"cell": 0}

    def started(cell: NotebookNode, cell_index: int) -> None:
        running["cell"] = cell_index + 1

    client.on_cell_start = started
    try:
        with tempfile.TemporaryDirectory() as profile, environment(scale, Path(profile)):
            client.execute(stderr=subprocess.DEVNULL)  # of the kernel, not of the page
    except CellExecutionError as error:
        reason = f"{error.ename}: {ESCAPE.sub('', error.evalue)}".strip().splitlines()[0]
        raise ValueError(f"{source.name}, cell {running['cell']}: {reason}") from error
    except CellTimeoutError as error:
        reason = f"takes longer than {client.timeout} s"
        raise ValueError(f"{source.name}, cell {running['cell']} {reason}") from error
    except DeadKernelError as error:
        raise ValueError(f"{source.name}, cell {running['cell']}: the kernel died") from error
    except RuntimeError as error:  # of nbclient and jupyter_client, before any cell
        raise ValueError(f"{source.name}: the kernel did not start: {error}") from error


def clean_outputs(nb: NotebookNode) -> None:
    """Leave in a notebook's outputs only what every run repeats and every reader can see.

    Progress bars go. A widget needs a running kernel, so the pictures that it shows at its start
    take its place: JupyterLab, GitHub and the site then all show the same.
    """
    state = nb.metadata.pop("widgets", {}).get(WIDGET_STATE, {}).get("state", {})
    for cell in nb.cells:
        if cell.cell_type == "code":
            cell.outputs = _joined(_without_widgets(cell.outputs, state))


def _without_widgets(outputs: list, models: dict[str, Any]) -> list:
    kept = []
    for output in outputs:
        view = output.get("data", {}).get(WIDGET_VIEW)
        kept += [output] if view is None else _shown_by(view["model_id"], models)
    return kept


def _shown_by(model: str, models: dict[str, Any]) -> list:
    """The outputs inside a widget and its children."""
    state = models.get(model, {}).get("state", {})
    found = [NotebookNode(output) for output in state.get("outputs", [])]
    for child in state.get("children", []):
        found += _shown_by(child.removeprefix(REFERENCE), models)
    return found


def _joined(outputs: list) -> list:
    """Neighbouring pieces of one stream as one, without progress bars and overwritten text."""
    joined: list = []
    for output in outputs:
        last = joined[-1] if joined else None
        if output.output_type == "stream" and last and last.get("name") == output.name:
            last.text += output.text
        else:
            joined.append(output)
    for output in joined:
        if output.output_type == "stream":
            output.text = _final(output.text)
    return [output for output in joined if output.output_type != "stream" or output.text.strip()]


def _final(text: str) -> str:
    """What a terminal shows in the end of a text that goes back to the start of its lines."""
    lines = []
    for line in ESCAPE.sub("", text).split("\n"):
        parts = [part for part in line.split("\r") if part.strip()]
        lines.append(parts[-1] if parts else "")
    ended = "" if PROGRESS.match(lines[-1]) else lines.pop()
    return "\n".join([*(line for line in lines if not PROGRESS.match(line)), ended])
