"""What `array_function` promises, of every function that it wraps: one test in place of hundreds.

Functions are found, not listed, and their inputs are made from the shapes that they declare. So a
module's own tests need not ask again whether it refuses a wrong shape, a NaN or a ragged list;
they test what else it refuses. What stands here by name is what a shape cannot say.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from types import FunctionType, ModuleType

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

import data_tools
import posecore
from posecore import cameras, metrics
from posecore.nets.rotation_heads import RotationCodec, RotationHead
from posecore.rotations import validity

# Finding them -----------------------------------------------------------------------------------


def modules() -> Iterator[ModuleType]:
    for package in (posecore, data_tools):
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not info.name.endswith("__main__"):  # which runs when it is imported
                yield importlib.import_module(info.name)


def functions() -> Iterator[FunctionType]:
    """Those written in each module, and the methods of its classes."""
    for module in modules():
        for thing in vars(module).values():
            if getattr(thing, "__module__", None) != module.__name__:
                continue
            inside = vars(thing).values() if inspect.isclass(thing) else [thing]
            yield from filter(inspect.isfunction, inside)


def declared(function: FunctionType) -> dict[str, tuple[str, ...]]:
    """The shapes that `array_function` checks, by argument; none if it does not wrap this one."""
    wraps = function.__code__.co_qualname == "array_function.<locals>.decorate.<locals>.wrapper"
    return inspect.getclosurevars(function).nonlocals["specs"] if wraps else {}


EVERY = list(functions())
WRAPPED = {function: specs for function in EVERY if (specs := declared(function))}
each_argument = pytest.mark.parametrize(
    ("function", "name"),
    [(function, name) for function, specs in WRAPPED.items() for name in specs],
    ids=lambda x: getattr(x, "__qualname__", x),
)

# Of what takes arrays, what checks them in its own way: lists of errors may be infinite, pictures
# are bytes, indices are whole numbers. Its module's tests show what it refuses.
ON_THEIR_OWN = {
    *("accuracy", "accuracy_curve", "auc", "average_precision", "average_recall"),
    *("balanced_mean_angular_error", "match_by_error", "match_by_overlap", "pair_by_overlap"),
    "mean_absolute_error",
    *("root_mean_squared_error", "within", "require_intrinsics", "require_rotation", "to_indices"),
    *("RotationHead.decode", "RotationHead.encode", "VectorFieldSystem.estimate"),
    *("VectorFieldSystem.estimate_fields", "field_targets", "vote", "vote_pixels"),
}
# Arguments of wrapped functions that are no array of numbers, or whose shape depends on another's.
BESIDE_THE_SHAPES = {"box", "indices", "mask", "symmetric", "x", "y"}


def test_what_takes_arrays_declares_their_shapes() -> None:
    """And so a decorator that is taken away, or an argument left out of it, is missed."""
    bare, left_out = set(), set()
    for function in EVERY:
        name = function.__qualname__
        arguments = inspect.signature(function).parameters.items()
        arrays = {key for key, argument in arguments if "Array" in str(argument.annotation)}
        if function in WRAPPED:
            left_out |= {(name, key) for key in arrays - set(WRAPPED[function]) - BESIDE_THE_SHAPES}
        elif arrays and "_" not in {part[0] for part in name.split(".")}:
            bare |= set() if function.__module__.startswith("posecore.figures.") else {name}
    assert not left_out
    assert bare == ON_THEIR_OWN


def test_the_makers_are_of_functions_that_there_are() -> None:
    names = {function.__qualname__ for function in WRAPPED}
    assert len(WRAPPED) > 60
    assert set(BESIDE) | set(MAKERS) | set(OBJECTS) | OF_THE_WHOLE <= names


def described(function: FunctionType, name: str) -> str:
    """What the docstring says of an argument; all, and its module's, if it has no list of them."""
    text = inspect.getdoc(function) or ""
    entry = re.search(rf"\n {{4}}(?:\w+, )*{name}(?:, \w+)*: (.*(?:\n {{8}}.*)*)", text)
    if not entry:
        return f"{text}\n{inspect.getmodule(function).__doc__}"
    return described(function, "predicted") if entry[1].startswith("the same shape") else entry[1]


def test_the_docstring_says_the_shape() -> None:
    """The reader's shape is the one that is checked; so neither is changed alone."""
    others = []
    for function, specs in WRAPPED.items():
        if function.__qualname__.startswith("_"):
            continue
        for name, spec in specs.items():
            sizes = ["[.]{3}" if s == "..." else s if s.isdigit() else r"\w+" for s in spec]
            end = "," if len(spec) == 1 and spec != ("...",) else ""
            if not re.search(rf"\({', '.join(sizes)}{end}\)", described(function, name)):
                others.append((function.__qualname__, name, spec, described(function, name)))
    assert others == []


# Making their inputs ----------------------------------------------------------------------------

SIZES = {"N": 6, "M": 5, "P": 7, "K": 4, "S": 2, "L": 6, "C": 4, "H": 5, "W": 7, "n": 6}

Values = dict[str, np.ndarray]


def rotations(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    count = int(np.prod(shape[:-2], dtype=int))
    return Rotation.random(max(count, 1), random_state=rng).as_matrix()[:count].reshape(shape)


def intrinsics(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    K = np.tile(np.array([[90.0, 1, 3], [0, 80, 2], [0, 0, 1]]), (*shape[:-2], 1, 1))
    K[..., :2, :] *= rng.uniform(0.9, 1.1, (*shape[:-2], 1, 1))
    return K


def motions(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    T = np.tile(np.eye(4), (*shape[:-2], 1, 1))
    T[..., :3, :3] = rotations((*shape[:-2], 3, 3), rng)
    return T


def in_front(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=shape) / 10 + [0, 0, 3]


def positive(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.5, 1.5, shape)


def directions(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=shape)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def anything(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=shape)


# By name, since one name means one thing in the whole library.
KINDS = [
    (r"R(_\w+)?", rotations),
    ("K|camera", intrinsics),
    ("T|symmetries", motions),
    (r"t(_\w+)?", in_front),
    (r"size(_\d)?|weights|diameter|scale|depth|boxes|box|\w*confidences?", positive),
    (r"\w+_normals", directions),
    ("mask|inside", lambda shape, rng: rng.integers(0, 2, shape).astype(float)),
    ("covariances", lambda shape, rng: np.eye(2) * positive((*shape[:-2], 1, 1), rng)),
    (r"\w+", anything),
]


def inputs(function: FunctionType, batches: tuple[tuple[int, ...], ...] = ((),)) -> Values:
    """Arrays that a function takes; the first, second, ... batch in turns to its arguments."""
    rng = np.random.default_rng(0)
    values: Values = {}
    for name, spec in WRAPPED[function].items():
        core = tuple(int(s) if s.isdigit() else SIZES[s] for s in spec if s != "...")
        batch = batches[len(values) % len(batches)] if spec[:1] == ("...",) else ()
        make = next(make for kind, make in KINDS if re.fullmatch(kind, name))
        values[name] = np.asarray(make((*batch, *core), rng))
    return values | MAKERS.get(function.__qualname__, lambda given: {})(values)


def _seen_points(given: Values) -> Values:
    R, t = rotations((3, 3), np.random.default_rng(1)), np.array([0, 0, 3.0])
    K = given["K"] * [[1, 0, 1], [1, 1, 1], [1, 1, 1]]  # OpenCV knows no skew
    pixels = cameras.project(K, given["points_3d"] @ R.T + t)
    return {"points_2d": pixels, "K": K} | ({"R": R, "t": t} if "R" in given else {})


def _seen_wall(given: Values) -> Values:
    """A wall of depth 3, and the points of a patch of it."""
    points = cameras.depth_to_points(np.full((5, 7), 3.0), given["K"])
    return {
        "depth": np.full((5, 7), 3.0),
        "model_points": points[::6] - [0, 0, 3],
        "model_normals": np.tile([0.0, 0, -1], (len(points[::6]), 1)),
        "R": np.eye(3),
        "t": np.array([0, 0, 3.01]),
    }


def spread(*shape: int) -> np.ndarray:
    return np.broadcast_to(np.arange(shape[-1]), shape).copy()


def _next_two(given: Values) -> np.ndarray:
    """(..., N, 2) of each point the two that follow."""
    *batch, n, _ = given["points"].shape
    return np.broadcast_to((np.arange(n)[:, None] + [1, 2]) % n, (*batch, n, 2)).copy()


# What is not any array of its shape: functions with arguments that have to fit each other.
MAKERS: dict[str, Callable[[Values], Values]] = {
    "correct_pose": lambda given: {"turn": given["R"].mT},
    "icp": lambda given: {"target": given["source"][:5], "R": np.eye(3), "t": np.zeros(3)},
    "project": lambda given: {"points": given["points"] + [0, 0, 9]},
    "pnp": _seen_points,
    "uncertainty_pnp": _seen_points,
    "ransac_umeyama": lambda given: {"target": 2 * given["source"][..., [1, 2, 0]] + 1},
    "refine_on_depth": _seen_wall,
}
# The arguments that are no arrays of numbers.
BESIDE: dict[str, Callable[[Values], dict[str, object]]] = {
    "ball_query": lambda given: {"radius": 1.0, "count": 2},
    "crop_and_resize_intrinsics": lambda given: {"box": [1, 2, 4, 3], "new_size": (8, 6)},
    "cross_product_normals": lambda given: {"indices": _next_two(given)},
    "crop_intrinsics": lambda given: {"x": 3, "y": 2},
    "estimate_normals": lambda given: {"k": 4},
    "farthest_point_sampling": lambda given: {"count": 3},
    "gather_points": lambda given: {"indices": spread(*given["values"].shape[:-2], 3)},
    "interpolate": lambda given: {"indices": spread(*given["weights"].shape)},
    "model_keypoints": lambda given: {"count": 3},
    "nearest_neighbours": lambda given: {"k": 2},
    "neighbour_directions": lambda given: {"indices": _next_two(given)},
    "pair_determinants": lambda given: {"indices": _next_two(given)},
    "pair_features": lambda given: {"indices": _next_two(given)},
    "ransac_umeyama": lambda given: {"threshold": 1e-3, "with_scale": True},
    "resize_intrinsics": lambda given: {"old_size": (8, 6), "new_size": (4, 3)},
    "turned_crop": lambda given: {"size": (8, 6)},
    "widened": lambda given: {"size": (8, 6), "margin": 1.2},
}
# The objects whose methods they are.
OBJECTS: dict[str, list[object]] = {
    "RotationCodec.encode": [RotationCodec(2, 8).double()],
    "RotationCodec.forward": [RotationCodec(2, 8).double()],
    "RotationCodec.spectrum": [RotationCodec(2, 8).double()],
    "RotationHead.loss": [RotationHead("6d")],
}
# What gives one number for all that is in the batch.
OF_THE_WHOLE = {"vector_loss", "projection_loss"}


def call(function: FunctionType, values: dict[str, object], like: Values | None = None) -> object:
    """Of `values` as they are; what depends on their shapes is made for `like`."""
    name = function.__qualname__
    beside = BESIDE.get(name, lambda given: {})(like or values)
    with torch.no_grad():
        return function(*OBJECTS.get(name, ()), **values, **beside)


# What they promise ------------------------------------------------------------------------------

NUMPY = (np.ndarray, np.generic)

each = pytest.mark.parametrize("function", WRAPPED, ids=lambda x: x.__qualname__)
each_batched = pytest.mark.parametrize(
    "function",
    [f for f, specs in WRAPPED.items() if ("...",) in {spec[:1] for spec in specs.values()}],
    ids=lambda x: x.__qualname__,
)


def parts(result: object) -> list:
    return [p for item in result for p in parts(item)] if isinstance(result, tuple) else [result]


def agree(found: list, expected: list, kind: type | tuple[type, ...]) -> None:
    """The same numbers, and all that is an array of numbers of one kind."""
    assert len(found) == len(expected) > 0
    for one, other in zip(found, expected, strict=True):
        if isinstance(other, NUMPY):
            assert isinstance(one, kind)
            np.testing.assert_allclose(np.asarray(one), other, rtol=1e-12, atol=1e-12)
        else:  # a count, a flag
            assert one == pytest.approx(other)


@each
def test_arrays_and_lists_give_arrays_and_tensors_tensors(function: FunctionType) -> None:
    values = inputs(function)
    tensors = {name: torch.from_numpy(value.copy()) for name, value in values.items()}
    expected = parts(call(function, values))
    assert any(isinstance(part, NUMPY) for part in expected)
    agree(expected, expected, NUMPY)
    lists = {name: value.tolist() for name, value in values.items()}
    agree(parts(call(function, lists, values)), expected, NUMPY)
    agree(parts(call(function, tensors, values)), expected, Tensor)
    for name in values:  # one tensor is enough
        agree(parts(call(function, values | {name: tensors[name]}, values)), expected, Tensor)
    for name, value in inputs(function).items():  # what came belongs to the caller
        assert np.array_equal(values[name], value)
        assert np.array_equal(tensors[name].numpy(), value)


@each_argument
def test_whole_numbers_and_flags_are_numbers(function: FunctionType, name: str) -> None:
    """Also where what they say is refused: then in the same words."""
    values = inputs(function)

    def outcome(given: object) -> object:
        try:
            return parts(call(function, values | {name: given}, values))
        except ValueError as error:
            return str(error)

    for kind in (np.int64, bool):
        whole = np.rint(2 * values[name]).astype(kind)
        expected = outcome(whole.astype(np.float64))
        for same in (whole, whole.tolist()):
            if isinstance(expected, str):
                assert outcome(same) == expected
            else:
                agree(outcome(same), expected, NUMPY)


@each_batched
def test_batches_that_broadcast_are_like_one_by_one(function: FunctionType) -> None:
    if function.__qualname__ in OF_THE_WHOLE:
        return
    specs = WRAPPED[function]
    batched = [name for name, spec in specs.items() if spec[:1] == ("...",)]
    values = inputs(function, ((2, 3), (3,), (2, 1)))
    cores = {
        name: values[name].shape[values[name].ndim - len(specs[name]) + 1 :] for name in batched
    }
    together = parts(call(function, values))
    for index in np.ndindex(2, 3):
        rows = {
            name: np.broadcast_to(values[name], (2, 3, *core))[index]
            for name, core in cores.items()
        }
        single = parts(call(function, values | rows))
        # A part that only some arguments decide may have the batch of those alone.
        pairs = zip(together, single, strict=True)
        picked = [np.broadcast_to(whole, (2, 3, *one.shape))[index] for whole, one in pairs]
        agree(picked, single, NUMPY)


@each_batched
def test_an_empty_batch_is_no_fault(function: FunctionType) -> None:
    for batch in ((0,), (2, 0)):
        for part in parts(call(function, inputs(function, (batch,)))):
            assert function.__qualname__ in OF_THE_WHOLE or part.shape[: len(batch)] == batch


# Under transforms of PyTorch there are no values to look at. What builds trees or hulls from values
# or cuts polygons needs them; `from_matrix` looks at them, as worlds are known by its code.
BY_VALUES = {
    *("add_s", "mssd", "mspd", "oriented_iou_3d", "nearest_neighbours", "ball_query"),
    *("interpolation_weights", "three_nearest_interpolation", "farthest_point_sampling"),
    *("chamfer_distance", "estimate_normals", "from_matrix"),
}
each_transformed = pytest.mark.parametrize(
    "function",
    [f for f in WRAPPED if f.__qualname__ not in {*BY_VALUES, *OF_THE_WHOLE, *OBJECTS}],
    ids=lambda x: x.__qualname__,
)


@pytest.mark.filterwarnings("ignore:There is a performance drop:UserWarning")
@each_transformed
def test_vmap_gives_the_batched_values(function: FunctionType) -> None:
    specs = WRAPPED[function]
    axes = {name: 0 if spec[:1] == ("...",) else None for name, spec in specs.items()}
    if 0 not in axes.values():
        return
    values = {k: torch.from_numpy(v.copy()) for k, v in inputs(function, ((4,),)).items()}
    one = {k: v.numpy()[0] if axes[k] == 0 else v.numpy() for k, v in values.items()}

    def single(*row: Tensor) -> tuple[Tensor, ...]:
        return tuple(parts(call(function, dict(zip(values, row, strict=True)), one)))

    found = torch.func.vmap(single, tuple(axes[k] for k in values))(*values.values())
    agree(list(found), [np.asarray(part) for part in parts(call(function, values))], Tensor)


# What asks of its values something besides their being finite, and those of rotations elsewhere.
CHECKED = [cameras.project, metrics.axis_error, metrics.closest_symmetry]


@pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning")
@pytest.mark.parametrize("function", CHECKED, ids=lambda x: x.__qualname__)
def test_checks_of_values_are_no_part_of_a_graph(function: FunctionType) -> None:
    values = {k: torch.from_numpy(v.copy()) for k, v in inputs(function, ((4,),)).items()}
    found = torch.compile(function, fullgraph=True, backend="eager")(**values)
    agree(parts(found), [np.asarray(part) for part in parts(call(function, values))], Tensor)


# What they refuse -------------------------------------------------------------------------------


def wrong_shapes(function: FunctionType, name: str, value: np.ndarray) -> Iterator[np.ndarray]:
    spec = WRAPPED[function][name]
    core = [size for size in spec if size != "..."]
    others = {size for key, spec in WRAPPED[function].items() if key != name for size in spec}
    for axis, size in enumerate(core, -len(core)):
        if size.isdigit():
            yield np.delete(value, -1, axis)
        else:
            yield value.take([], axis)  # an empty cloud
        if size.isdigit() or size in others:
            yield np.concatenate([value, value.take([0], axis)], axis)
    if core:
        yield value[0]
    if core == list(spec):
        yield value[None]


def no_numbers(function: FunctionType, name: str, value: np.ndarray) -> Iterator[object]:
    for bad in (np.nan, np.inf, -np.inf):
        wrong = value.copy()
        wrong.flat[-1] = bad
        yield wrong
        yield torch.from_numpy(wrong)
    yield from ([[1.0], [1.0, 2.0]], "words", {"x": 1}, [[None]], [torch.ones(3), torch.ones(3)])
    yield from (value.astype(complex), torch.from_numpy(value).to(torch.complex64))
    if inspect.signature(function).parameters[name].default is not None:
        yield None


@each_argument
def test_bad_input_is_refused_by_name(function: FunctionType, name: str) -> None:
    values, specs = inputs(function), WRAPPED[function]
    call(function, values)  # or else any fault would do

    def complaint(given: dict[str, object]) -> str:
        with pytest.raises(ValueError) as caught:
            call(function, values | given, values)
        return str(caught.value).partition(": expected ")[0]

    for bad in no_numbers(function, name, values[name]):
        assert complaint({name: bad}) == name, bad
    for bad in wrong_shapes(function, name, values[name]):
        # Of two arguments that differ in a size which they should share, either may be wrong.
        sharing = {key for key, spec in specs.items() if set(spec) & set(specs[name]) - {"..."}}
        assert complaint({name: bad}) in sharing, bad.shape
    batched = [key for key, spec in specs.items() if spec[:1] == ("...",)]
    if name in batched and len(batched) > 1:
        many = {key: np.tile(values[key], (3, *(1,) * values[key].ndim)) for key in batched}
        assert complaint(many | {name: many[name][:2]}) == " and ".join(batched)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
@each
def test_half_precision_is_no_fault(
    function: FunctionType, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The numbers that it holds, computed in single precision; or refused in the same words.

    But for rotations, of which no more digits are asked than it has.
    """
    if function.__qualname__ in OBJECTS:  # networks have a precision of their own
        return
    base = inputs(function)
    halves = {name: torch.from_numpy(value.copy()).to(dtype) for name, value in base.items()}

    def outcome(kind: torch.dtype) -> list | str:
        try:
            return parts(call(function, {n: v.to(kind) for n, v in halves.items()}, base))
        except ValueError as error:
            return str(error).partition(", got")[0]

    found = outcome(dtype)
    monkeypatch.setattr(validity, "input_precision", lambda: torch.finfo(dtype).eps)
    expected = outcome(torch.float32)
    assert isinstance(found, str) == isinstance(expected, str), (found, expected)
    if isinstance(found, str):
        assert found == expected
        return
    for one, other in zip(found, expected, strict=True):
        if isinstance(one, Tensor) and one.dtype == dtype:  # of those that move features about
            torch.testing.assert_close(one.float(), other, rtol=2e-2, atol=2e-2)
        else:
            assert type(one) is type(other)
            np.testing.assert_allclose(np.asarray(one), np.asarray(other), rtol=1e-5, atol=1e-5)
