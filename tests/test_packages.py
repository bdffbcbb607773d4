"""What packages promise: they export what they hold, and what raises says so."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TREES = {
    path.relative_to(ROOT): ast.parse(path.read_text(encoding="utf-8"))
    for package in ("posecore", "data_tools")
    for path in sorted((ROOT / package).rglob("*.py"))
}

# Exports ------------------------------------------------------------------------------------------

# What a package has for itself, by module, or by module and name: why nobody else is offered it.
KEPT = {
    "posecore.clouds.search": "the searches on tensors that are checked, on which the others build",
    "posecore.fingerprint.modules": "a step of `closure`",
    "posecore.fingerprint.plain": "a step of `closure`",
    "posecore.fingerprint.walk": "a step of `closure`",
    "posecore.metrics.bop_scores.matches": "a step of `average_recalls`",
    "posecore.metrics.bop_scores.surest_of_images": "a step of `detection_precision`",
    "posecore.metrics.model_errors.threads_for_searches": "of `evaluate`, for many calls in a row",
    "posecore.metrics.motions": "the search for the best symmetry, within `mssd` and `mspd`",
    "posecore.nets.graph3d.fused": "how `SurfaceConv` and `GraphConv` save memory",
    "posecore.nets.pointnet2.fused": "how `SetAbstraction` saves memory",
    "posecore.nets.rotation_heads.decoders.full_precision": "what decoders do within autocast",
    "posecore.registration.planar": "the starts of `pnp` for flat objects",
    "posecore.splat.volumes": "the projector's arithmetic, with gradients by hand",
    "data_tools.batches.augmentation.Draws": "what `Augmentation` drew",
    "data_tools.batches.decoding": "how `load` makes a file",
    "data_tools.batches.files": "how `load` makes a file",
    "data_tools.batches.identity": "how `load` knows a dataset again",
    "data_tools.batches.indices": "arguments of `Stack`",
    "data_tools.batches.memory": "what `load` refuses",
    "data_tools.batches.sampling": "how `Stack` cuts",
    "data_tools.batches.table": "what `Stack` knows of objects",
    "data_tools.bop.files": "files that may be damaged, for the readers of all layouts",
    "data_tools.bop.layout": "a step of `BopDataset`",
    "data_tools.bop.pictures": "a step of `BopDataset`",
    "data_tools.bop.pieces": "parts of a `BopDataset`, for `evaluate`",
    "data_tools.bop.polygons": "a step of `read_ply`",
    "data_tools.bop.rotations.check_rotations": "for the readers of all layouts",
    "data_tools.bop.scenes": "steps of `BopDataset`; its warnings are exported",
    "data_tools.checking.agreement": "a step of `check_dataset`",
    "data_tools.checking.blobs": "a step of `check_dataset`",
    "data_tools.checking.camera_fits": "a step of `check_dataset`",
    "data_tools.checking.boxes": "a step of `check_dataset`",
    "data_tools.checking.colours": "a step of `check_dataset`",
    "data_tools.checking.command": "the command, which `data_tools.main` has",
    "data_tools.checking.corrections": "a step of `check_dataset`",
    "data_tools.checking.depths": "a step of `check_dataset`",
    "data_tools.checking.drawing": "a step of `check_dataset`",
    "data_tools.checking.explaining": "a step of `check_dataset`",
    "data_tools.checking.fits": "a step of `check_dataset`",
    "data_tools.checking.geometry": "a step of `check_dataset`",
    "data_tools.checking.pictures": "a step of `check_dataset`",
    "data_tools.checking.sample": "a step of `check_dataset`",
    "data_tools.checking.shifts": "a step of `check_dataset`",
    "data_tools.checking.wording": "a step of `check_dataset`",
    "data_tools.bop.surfaces": "a step of `measure_model`",
    "data_tools.hmdpose.calibration": "a step of `HmdposeDataset`",
    "data_tools.hmdpose.pictures": "a step of `HmdposeDataset`",
    "data_tools.hmdpose.tables": "a step of `HmdposeDataset`",
    "data_tools.linemod.folders": "a step of `LinemodDataset`",
    "data_tools.linemod.poses": "a step of `LinemodDataset`",
    "data_tools.renderer.clipping": "a step of `rasterise`",
    "data_tools.renderer.rasteriser.affine": "a step of `rasterise`",
    "data_tools.renderer.samples": "a step of `render_colour`",
    "data_tools.renderer.scanlines": "a step of `rasterise`",
    "data_tools.renderer.shading": "a step of `render_colour`",
    "data_tools.renderer.shadows": "a step of `render_colour`",
    "data_tools.renderer.surfaces": "a step of `render_colour`",
    "data_tools.renderer.visibility": "a step of `render_labels`",
    "data_tools.shapes.cabin": "a part of `make_seat` and `make_subject`",
    "data_tools.shapes.faces": "a part of `make_subject`",
    "data_tools.shapes.gadgets": "a part of `make_category`",
    "data_tools.shapes.hair": "a part of `make_subject`",
    "data_tools.shapes.toys": "a part of `make_object`",
    "data_tools.shapes.vessels": "a part of `make_category`",
    "data_tools.storage.folders": "a step of `Store`",
    "data_tools.storage.locks": "a step of `Store`",
    "data_tools.storage.making": "a step of `Store`; its error is exported",
    "data_tools.storage.records": "a step of `Store`",
    "data_tools.storage.shards": "a step of `Store`; its error is exported",
    "data_tools.textures.prints": "patterns, which `albedo` finds by name",
}


def public(tree: ast.Module) -> list[str]:
    """`__all__`, as it is written."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return ast.literal_eval(node.value)
    return []


def held(tree: ast.Module) -> set[str]:
    """The public functions and classes that a module defines."""
    kinds = ast.FunctionDef | ast.ClassDef
    defined = {node.name for node in tree.body if isinstance(node, kinds)}
    return defined & set(public(tree))


def offers_modules(package: ast.Module) -> bool:
    """Whether a package offers all of its modules, by `posecore.lazy.submodule`."""
    return any(isinstance(n, ast.FunctionDef) and n.name == "__getattr__" for n in package.body)


def kept() -> Iterator[str]:
    """What packages hold and do not offer: a module if none of it is offered, else each name."""
    for path, package in TREES.items():
        if path.name != "__init__.py" or offers_modules(package):
            continue
        for other, tree in TREES.items():
            if other.parent != path.parent or other.stem.startswith("__"):
                continue
            module = ".".join(other.with_suffix("").parts)
            hidden = held(tree) - set(public(package))
            if not hidden or other.stem in public(package):
                continue
            yield from [f"{module}.{name}" for name in sorted(hidden)]


def reason(name: str) -> str | None:
    return KEPT.get(name) or KEPT.get(name.rpartition(".")[0])


def test_packages_export_what_they_hold():
    """The name, or its module, or there is a reason why neither."""
    assert [name for name in kept() if not reason(name)] == []


def test_reasons_are_of_what_is_kept():
    names = set(kept())
    modules = {name.rpartition(".")[0] for name in names}
    assert set(KEPT) <= names | modules


def test_every_package_is_looked_at():
    packages = {path.parent for path in TREES if path.name == "__init__.py"}
    assert {path.parent for path in TREES} == packages
    assert len(packages) > 20
    for package in packages - {Path("data_tools")}:  # which offers what `open` is about
        assert public(TREES[package / "__init__.py"]) or offers_modules(
            TREES[package / "__init__.py"]
        ), package


# Raises -------------------------------------------------------------------------------------------


def raises(function: ast.FunctionDef) -> set[str]:
    """What a function calls or raises itself, not in functions within it, to refuse something."""
    found, todo = set(), list(function.body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Lambda):
            continue
        if isinstance(node, ast.Raise) and node.exc is not None:
            raised = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            found |= {ast.unparse(raised)} & {"ValueError"}
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            found |= {name} if name == "fail" or name.startswith("require_") else set()
        todo += ast.iter_child_nodes(node)
    return found


def silent(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """The public functions, methods and classes that refuse something and do not say so."""

    def look(body: list[ast.stmt], within: ast.ClassDef | None = None) -> Iterator[tuple[str, int]]:
        for node in body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                yield from look(node.body, node)
            if not isinstance(node, ast.FunctionDef):
                continue
            making = within is not None and node.name in ("__init__", "__post_init__")
            if node.name.startswith("_") and not making:
                continue
            says = within if making else node  # the class speaks for how it is made
            if raises(node) and "Raises" not in (ast.get_docstring(says) or ""):
                yield says.name, node.lineno

    yield from look(tree.body)


@pytest.mark.parametrize("path", TREES, ids=str)
def test_what_raises_says_so(path):
    assert list(silent(TREES[path])) == []


@pytest.mark.parametrize(
    "body",
    [
        "def f(x):\n '''Words.'''\n fail('x', 'a', x)",
        "def f(x):\n '''Words.'''\n if x:\n  raise ValueError(x)",
        "def f(x):\n '''Words.'''\n with x:\n  return arrays.require_number('x', x)",
        "class f:\n '''Words.'''\n def __init__(self, x): require_integer('x', x)",
        "class A:\n '''Words.'''\n def f(self, x):\n  '''Words.'''\n  fail('x', 'a', x)",
    ],
)
def test_silence_is_seen(body):
    assert [name for name, _ in silent(ast.parse(body))] == ["f"]
    spoken = body.replace("Words.", "Words.\n\n Raises:\n  ValueError: if so.\n ")
    assert list(silent(ast.parse(spoken))) == []


@pytest.mark.parametrize(
    "body",
    [
        "def _f(x): fail('x', 'a', x)",
        "def f(x):\n def g(): fail('x', 'a', x)\n return g",
        "def f(x):\n raise NotImplementedError",
        "class _A:\n def f(self, x): fail('x', 'a', x)",
    ],
)
def test_what_needs_no_word(body):
    assert list(silent(ast.parse(body))) == []
