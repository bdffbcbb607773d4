"""Heads: every representation and loss by name, and what is said of them in the table."""

import copy
import functools
import pickle
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from torch import nn

from posecore.nets.rotation_heads import LOSSES, REPRESENTATIONS, RotationCodec, RotationHead
from posecore.rotations import axis_angle_to_matrix, euler_to_matrix

SIZES = {
    "quaternion": 4,
    "axis_angle": 3,
    "euler": 3,
    "6d": 6,
    "procrustes": 9,
    "learnable": 9,
}
FORMULAS = [name for name in SIZES if name != "learnable"]
CONTINUOUS = ("6d", "procrustes", "learnable")
EPS = {dtype: torch.finfo(dtype).eps for dtype in (torch.float32, torch.float64)}

each = pytest.mark.parametrize("name", SIZES)
each_formula = pytest.mark.parametrize("name", FORMULAS)
PAIRS = [(n, loss) for n in SIZES for loss in LOSSES if loss != "sign_free" or n == "quaternion"]
each_pair = pytest.mark.parametrize(("name", "loss"), PAIRS)
each_dtype = pytest.mark.parametrize("dtype", EPS)


def head_of(name: str, loss: str | None = None, **options: object) -> RotationHead:
    """A head; its codec, where it has one, is not trained: what is tested holds for any."""
    torch.manual_seed(0)
    codec = RotationCodec(octaves=2, width=16) if name == "learnable" else None
    return RotationHead(name, loss, codec=codec, **options)


@functools.cache
def rotations() -> torch.Tensor:
    """Random ones, the identity, half turns, those at and near gimbal lock, and nearly half."""
    vectors = np.random.default_rng(0).normal(size=(20, 3))
    axes = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    axes[:6] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]]
    turns = [Rotation.from_rotvec(a * axes) for a in (1e-12, 1e-4, np.pi / 2, np.pi - 1e-7, np.pi)]
    locked = Rotation.from_euler("YXZ", [[0.3, s * np.pi / 2, -1] for s in (1, -1, 1 - 1e-7)])
    signed = Rotation.create_group("O")  # the 24 matrices of 0 and +-1
    parts = [Rotation.random(80, random_state=1), *turns, locked, signed]
    return torch.from_numpy(np.concatenate([part.as_matrix() for part in parts]))


def angle(R_1: torch.Tensor, R_2: torch.Tensor) -> torch.Tensor:
    R_1, R_2 = (Rotation.from_matrix(R.double()) for R in (R_1, R_2))
    return torch.from_numpy((R_1.inv() * R_2).magnitude())


@each
def test_names_and_sizes(name: str) -> None:
    assert set(REPRESENTATIONS) == set(SIZES)
    head = head_of(name)
    assert head.size == SIZES[name]
    assert head.loss_name == ("output" if name == "learnable" else "chordal")
    assert repr(name) in repr(head)


@each_formula
@each_dtype
def test_there_and_back(name: str, dtype: torch.dtype) -> None:
    R = rotations().to(dtype)
    head = head_of(name)
    outputs = head.encode(R)
    assert outputs.shape == (len(R), SIZES[name]) and outputs.dtype == dtype
    assert (head.decode(outputs) - R).abs().max() < 32 * EPS[dtype]
    assert torch.equal(head(outputs), head.decode(outputs))


def test_the_targets_are_those_of_the_table() -> None:
    R = rotations()
    q = head_of("quaternion").encode(R)
    assert (q[:, 0] >= 0).all()
    v = head_of("axis_angle").encode(R)
    assert v.norm(dim=-1).max() < np.pi + 1e-15
    for target, half in ((q[:, 1:], q[:, 0] == 0), (v, q[:, 0] == 0)):
        assert half.sum() >= 9  # the half turns of the group, at least
        first = torch.stack([row[row != 0][0] for row in target[half]])
        assert (first > 0).all()
    yaw_pitch_roll = head_of("euler").encode(R)
    assert (yaw_pitch_roll[:, 1].abs() <= np.pi / 2).all()
    lock = head_of("euler").encode(euler_to_matrix(torch.tensor([0.3, np.pi / 2, -1])))
    assert lock[2] == 0
    assert torch.equal(head_of("6d").encode(R), R[..., :2].mT.flatten(-2))
    assert torch.equal(head_of("procrustes").encode(R), R.flatten(-2))


def jump(name: str, axis: list[float], steps: int = 2000) -> float:
    """The largest step of the target while an object turns once, in units of a smooth one."""
    angles = torch.linspace(0, 2 * np.pi, steps + 1, dtype=torch.float64)
    target = head_of(name).encode(axis_angle_to_matrix(angles[:, None] * torch.tensor(axis)))
    step = (target[1:] - target[:-1]).norm(dim=-1)
    return float(step.max() / step.median())


@each
@pytest.mark.parametrize("axis", [[0.0, 1, 0], [0.36, 0.48, 0.8]])
def test_what_is_continuous_and_what_jumps(name: str, axis: list[float]) -> None:
    # A jump is of a size of its own, a smooth step 1 / steps of the way.
    assert jump(name, axis) < 5 if name in CONTINUOUS else jump(name, axis) > 500


@pytest.mark.parametrize(
    ("name", "size"), [("quaternion", 2), ("axis_angle", 2 * np.pi), ("euler", 2 * np.pi)]
)
def test_the_size_of_a_jump(name: str, size: float) -> None:
    before, after = (
        head_of(name).encode(axis_angle_to_matrix([0, a, 0])) for a in (np.pi - 1e-9, np.pi + 1e-9)
    )
    assert abs(np.linalg.norm(after - before) - size) < 1e-8


@each_pair
@each_dtype
def test_losses_are_the_distances_of_the_table(name: str, loss: str, dtype: torch.dtype) -> None:
    R = rotations().to(dtype)
    head = head_of(name, loss)
    outputs = torch.randn(
        len(R), head.size, dtype=dtype, generator=torch.Generator().manual_seed(0)
    )
    found = head.loss(outputs, R)
    target, decoded = head.encode(R), head.decode(outputs)
    if loss == "geodesic":
        expected = angle(decoded, R)
    elif loss == "chordal":
        expected = np.sqrt(8) * torch.sin(angle(decoded, R) / 2)
    else:
        expected = np.linalg.norm(outputs - target, axis=-1)
        if loss == "sign_free":
            other = np.linalg.norm(outputs + target, axis=-1)
            assert (other < expected).any()
            expected = np.minimum(expected, other)
    assert found.shape == (len(R),) and found.dtype == dtype
    tolerance = 64 * EPS[dtype]
    assert (found - torch.as_tensor(expected)).abs().max() < tolerance
    squared = head_of(name, loss, squared=True).loss(outputs, R)
    assert torch.equal(squared, found**2)


@each_pair
@pytest.mark.parametrize("squared", [False, True])
def test_the_loss_of_the_target_is_zero(name: str, loss: str, squared: bool) -> None:
    head = head_of(name, loss, squared=squared)
    R = rotations()
    if name == "learnable" and loss != "output":  # what its codec says is not quite R
        outputs = R.flatten(-2)
    else:
        outputs = head.encode(R)
    assert head.loss(outputs, R).abs().max() < 64 * EPS[torch.float64]
    if name == "quaternion":
        other = head.loss(-outputs, R)
        assert (other > 1.9).all() if loss == "output" else (other < 1e-13).all()


@each_pair
@each_dtype
@pytest.mark.parametrize("squared", [False, True])
def test_gradients_are_finite_everywhere(
    name: str, loss: str, dtype: torch.dtype, squared: bool
) -> None:
    R = rotations().to(dtype)
    head = head_of(name, loss, squared=squared)
    half_turn = R @ torch.diag(torch.tensor([1.0, -1, -1], dtype=dtype))
    random = torch.randn(len(R), head.size, dtype=dtype, generator=torch.Generator().manual_seed(0))
    exact, opposite = head.encode(R), head.encode(half_turn)
    for outputs in (exact, -exact, opposite, 0 * random, 1e-30 * random, 1e15 * random):
        outputs = outputs.clone().requires_grad_()
        value = head.loss(outputs, R)
        (grad,) = torch.autograd.grad(value.sum(), outputs)
        assert torch.isfinite(value).all() and torch.isfinite(grad).all()


@each_pair
def test_derivatives_are_those_of_finite_differences(name: str, loss: str) -> None:
    head = head_of(name, loss).double()
    R = rotations()[:4]
    outputs = torch.randn(
        4, head.size, dtype=torch.float64, generator=torch.Generator().manual_seed(1)
    )
    outputs = (outputs + head.encode(R)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: head.loss(x, R), outputs)


@each_formula
def test_derivatives_of_targets_are_those_of_finite_differences(name: str) -> None:
    head = head_of(name)
    v = torch.tensor([[0.3, -1, 0.5], [1.2, 0.1, 2]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: head.encode(axis_angle_to_matrix(x)), v)


# A learnable target leads to what its codec says, which is not trained here.
@pytest.mark.parametrize(("name", "loss"), [p for p in PAIRS if p != ("learnable", "output")])
def test_descent_finds_the_rotation(name: str, loss: str) -> None:
    R = Rotation.from_rotvec([[0.5, 0.1, -0.3], [-0.4, 0.2, 0.6]]).as_matrix()
    R = torch.from_numpy(R)
    head = head_of(name, loss, squared=True)
    outputs = nn.Parameter(head.encode(torch.eye(3, dtype=torch.float64)).repeat(2, 1) + 0.1)
    optimiser = torch.optim.LBFGS([outputs], max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        value = head.loss(outputs, R).sum()
        value.backward()
        return value

    optimiser.step(closure)
    assert angle(head.decode(outputs.detach()), R).max() < 1e-3


def test_the_codec_is_but_another_target() -> None:
    generator = torch.Generator().manual_seed(0)
    outputs, R = torch.randn(len(rotations()), 9, generator=generator), rotations().float()
    for loss in ("chordal", "geodesic"):
        losses = [head_of(name, loss).loss(outputs, R) for name in ("procrustes", "learnable")]
        assert torch.equal(*losses)
    with_codec = head_of("learnable", "output")
    assert torch.equal(with_codec.encode(R), with_codec.codec.encode(R))
    assert not torch.equal(with_codec.encode(R), R.flatten(-2))


def test_a_codec_is_frozen_and_travels_with_its_network() -> None:
    head = head_of("learnable")
    network = nn.Sequential(nn.Linear(5, 9), head)
    assert sum(p.requires_grad for p in network.parameters()) == 2
    R = rotations()[:3].float()
    network.requires_grad_(True)  # as after a phase with frozen layers
    assert not head.encode(R).requires_grad
    head.loss(network[0](torch.ones(3, 5)), R).sum().backward()
    assert network[0].weight.grad.abs().max() > 0
    assert all(p.grad is None for p in head.parameters())
    other = nn.Sequential(nn.Linear(5, 9), head_of("learnable"))
    for p in other.parameters():
        p.data.zero_()
    other.load_state_dict(network.state_dict())
    assert torch.equal(other[1].encode(R), head.encode(R))
    for copied in (copy.deepcopy(head), pickle.loads(pickle.dumps(head))):
        assert torch.equal(copied.encode(R), head.encode(R))
    assert all(not list(head_of(name).parameters()) for name in FORMULAS)


@each_pair
def test_autocast(name: str, loss: str) -> None:
    torch.manual_seed(0)
    layer, head = nn.Linear(7, SIZES[name]), head_of(name, loss)
    features, R = torch.randn(20, 7), rotations()[:20].float()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        outputs = layer(features)
        assert outputs.dtype == torch.bfloat16
        value = head.loss(outputs, R)
    assert value.dtype == torch.float32
    assert torch.equal(value, head.loss(outputs.float(), R))
    value.mean().backward()
    assert torch.isfinite(layer.weight.grad).all() and layer.weight.grad.abs().max() > 0


@each_pair
@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)])
def test_any_batch_and_arrays(name: str, loss: str, batch: tuple) -> None:
    head = head_of(name, loss)
    R = rotations()[: int(np.prod(batch))].reshape(*batch, 3, 3)
    outputs = torch.randn(
        *batch, head.size, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    )
    found = head.loss(outputs, R)
    assert found.shape == batch
    assert head.decode(outputs).shape == R.shape and head.encode(R).shape == outputs.shape
    assert isinstance(head.encode(R.numpy()), np.ndarray)
    assert np.array_equal(head.loss(outputs.numpy(), R.numpy()), found.numpy())
    wider = head.loss(outputs.expand(4, *outputs.shape), R)  # a batch that broadcasts
    assert torch.equal(wider, found.expand(4, *found.shape))


@pytest.mark.slow
@given(
    hnp.arrays(float, 9, elements=st.floats(-1e6, 1e6)),
    hnp.arrays(float, 3, elements=st.floats(-4, 4)),
    st.sampled_from(PAIRS),
)
def test_any_outputs_have_a_rotation_and_a_loss(
    numbers: np.ndarray, v: np.ndarray, pair: tuple[str, str]
) -> None:
    name, loss = pair
    head, R = head_of(name, loss), axis_angle_to_matrix(v)
    outputs = numbers[: head.size]
    decoded = head.decode(outputs)
    assert np.abs(decoded @ decoded.T - np.eye(3)).max() < 32 * EPS[torch.float64]
    value = head.loss(outputs, R)
    assert value >= 0
    if loss == "geodesic":
        assert value <= np.pi
    if loss == "chordal":
        assert value <= np.sqrt(8) + 1e-14
    if name in FORMULAS:
        assert np.abs(head.decode(head.encode(R)) - R).max() < 32 * EPS[torch.float64]


HALF = torch.eye(3)[:2]
BAD = [
    (lambda: RotationHead("matrix"), "representation"),
    (lambda: RotationHead("6D"), "representation"),
    (lambda: RotationHead(None), "representation"),
    (lambda: RotationHead("6d", "l2"), "loss"),
    (lambda: RotationHead("6d", 2), "loss"),
    (lambda: RotationHead("6d", "sign_free"), "loss"),
    (lambda: RotationHead("learnable"), "codec"),
    (lambda: RotationHead("learnable", codec=nn.Linear(9, 9)), "codec"),
    (lambda: RotationHead("procrustes", codec=RotationCodec()), "codec"),
    (lambda: RotationHead("quaternion").decode(torch.zeros(3)), "outputs"),
    (lambda: RotationHead("6d").decode(torch.full((6,), torch.nan)), "outputs"),
    (lambda: RotationHead("euler").encode(2 * torch.eye(3)), "R"),
    (lambda: RotationHead("procrustes").encode(-torch.eye(3)), "R"),
    (lambda: RotationHead("6d").encode(HALF), "R"),
    (lambda: head_of("learnable").encode(torch.zeros(3, 3)), "R"),
    (lambda: RotationHead("6d").loss(torch.ones(4), torch.eye(3)), "outputs"),
    (lambda: RotationHead("quaternion", "output").loss(torch.ones(1), torch.eye(3)), "outputs"),
    (lambda: RotationHead("euler", "geodesic").loss(torch.ones(3), 2 * torch.eye(3)), "R_gt"),
    (lambda: RotationHead("euler", "output").loss(torch.ones(3), -torch.eye(3)), "R_gt"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "name"), BAD)
def test_bad_input(call: Callable, name: str) -> None:
    with pytest.raises(ValueError, match=rf"^([\w ]+ and )?{name}: expected .*, got "):
        call()
