"""The codec: it learns, is the same for the same seed, and comes back from its file."""

import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore.nets.rotation_heads import (
    RotationCodec,
    RotationHead,
    load_codec,
    save_codec,
    train_codec,
)
from posecore.rotations import axis_angle_to_matrix, geodesic_distance, hat, random_rotations

TEST = random_rotations(1000, generator=12345, dtype=torch.float32)
SIGNED = torch.from_numpy(Rotation.create_group("O").as_matrix()).float()


def digest(codec: RotationCodec) -> str:
    weights = b"".join(tensor.numpy().tobytes() for tensor in codec.state_dict().values())
    return hashlib.sha256(weights).hexdigest()


@pytest.fixture(scope="module")
def codec() -> RotationCodec:
    """Less than a second's training."""
    return train_codec(seed=0, steps=200, learning_rate=1e-2)


@pytest.fixture
def small() -> RotationCodec:
    """One that is not trained."""
    torch.manual_seed(0)
    return RotationCodec(octaves=1, width=8)


def test_shapes_of_the_paper() -> None:
    codec = RotationCodec()
    shapes = {name: tuple(p.shape) for name, p in codec.named_parameters()}
    assert shapes == {
        "project.weight": (128, 9 * 2 * 4),
        "project.bias": (128,),
        "mlp.0.weight": (128, 128),
        "mlp.0.bias": (128,),
        "mlp.2.weight": (9, 128),
        "mlp.2.bias": (9,),
    }
    assert RotationCodec(octaves=10).project.in_features == 180


@pytest.mark.slow
def test_it_learns_to_a_few_degrees(codec: RotationCodec) -> None:
    # The paper's network that learns this target has 0.68 degrees on average, after far more steps.
    error = torch.rad2deg(geodesic_distance(codec(TEST), TEST))
    assert 0.1 < error.mean() < 3
    assert error.max() < 9
    # No hole where entries are -1 or 1, which sines and cosines of whole turns take for the same.
    assert torch.rad2deg(geodesic_distance(codec(SIGNED), SIGNED)).max() < 9


@pytest.mark.slow
def test_training_reports_a_falling_loss() -> None:
    reports: list[tuple[int, float]] = []
    train_codec(seed=1, steps=60, batch=64, report=lambda *values: reports.append(values))
    steps, losses = zip(*reports, strict=True)
    assert steps == tuple(range(1, 61))
    assert 4 < losses[0] < 8  # the mean over random pairs is 6
    assert np.mean(losses[-10:]) < losses[0] / 20


@pytest.mark.slow
def test_geodesic_loss() -> None:
    reports: list[float] = []
    options = {"seed": 1, "steps": 60, "batch": 64}
    codec = train_codec(**options, loss="geodesic", report=lambda _, value: reports.append(value))
    assert 1.5 < reports[0] < 3  # radians
    assert geodesic_distance(codec(TEST), TEST).mean() < 0.2
    assert digest(codec) != digest(train_codec(**options))


def test_the_same_seed_is_the_same_codec() -> None:
    options = {"steps": 5, "batch": 16, "width": 8, "octaves": 2}
    before = torch.get_rng_state()
    first = train_codec(seed=3, **options)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(99)
    assert digest(train_codec(seed=3, **options)) == digest(first)
    assert digest(train_codec(seed=4, **options)) != digest(first)


@pytest.mark.slow
def test_it_is_frozen(codec: RotationCodec) -> None:
    assert not any(p.requires_grad for p in codec.parameters())
    assert not codec.encode(TEST).requires_grad
    R = TEST[:5].clone().requires_grad_()  # a gradient passes through all the same
    (grad,) = torch.autograd.grad(codec.encode(R).sum(), R)
    assert torch.isfinite(grad).all() and grad.abs().max() > 0


def test_the_code_by_hand(small: RotationCodec) -> None:
    R = Rotation.from_rotvec([0.3, -0.2, 1]).as_matrix()
    weights = {name: p.detach().double().numpy() for name, p in small.named_parameters()}
    waves = np.stack([np.sin(R.ravel()), np.cos(R.ravel())], -1).ravel()
    hidden = weights["project.weight"] @ waves + weights["project.bias"]
    hidden = weights["mlp.0.weight"] @ hidden + weights["mlp.0.bias"]
    hidden = np.where(hidden > 0, hidden, 0.01 * hidden)
    code = weights["mlp.2.weight"] @ hidden + weights["mlp.2.bias"]
    found = small.encode(R)
    assert found.dtype == np.float64
    assert np.abs(found - code).max() < 1e-6
    U, _, Vt = np.linalg.svd(code.reshape(3, 3))
    nearest = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    assert np.abs(small(R) - nearest).max() < 1e-5


def test_frequencies_are_octaves() -> None:
    torch.manual_seed(0)
    codec = RotationCodec(octaves=3, width=54)
    codec.project.weight.data.copy_(torch.eye(54))
    codec.project.bias.data.zero_()
    seen: list[torch.Tensor] = []
    codec.mlp.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    codec.encode(TEST[0])
    x = TEST[0].flatten()[:, None] * torch.tensor([1.0, 2, 4])
    expected = torch.cat([x.sin(), x.cos()], -1).flatten()
    assert (seen[0] - expected).abs().max() < 1e-6


def test_spectrum_and_scale(codec: RotationCodec) -> None:
    spectrum = codec.spectrum(TEST)
    code = codec.encode(TEST).unflatten(-1, (3, 3))
    assert (spectrum[:, :-1] >= spectrum[:, 1:].abs()).all()
    assert (spectrum.abs() - torch.linalg.svdvals(code)).abs().max() < 1e-5
    assert (spectrum.prod(-1) - torch.linalg.det(code)).abs().max() < 1e-4
    scale = (codec(TEST) * code).sum((-2, -1)) / 3
    assert (spectrum.mean(-1) - scale).abs().max() < 1e-5


def test_the_scale_is_arbitrary(codec: RotationCodec) -> None:
    other = RotationCodec()
    other.load_state_dict(codec.state_dict())
    for p in other.mlp[2].parameters():
        p.data.mul_(7)
    assert (other(TEST) - codec(TEST)).abs().max() < 1e-5
    assert (other.spectrum(TEST) / codec.spectrum(TEST) - 7).abs().max() < 1e-3
    outputs = torch.zeros(1000, 9)
    losses = [RotationHead("learnable", codec=c).loss(outputs, TEST) for c in (codec, other)]
    assert (losses[1] / losses[0] - 7).abs().max() < 1e-4


def test_an_error_of_the_outputs_turns_by_it_over_two_singular_values(codec: RotationCodec) -> None:
    # R' = R P; the outputs R' + delta R hat(axis) turn about an eigenvector of P.
    R, code = codec(TEST).double(), codec.encode(TEST).double().unflatten(-1, (3, 3))
    values, vectors = torch.linalg.eigh(R.mT @ code)  # from small to large
    axis, delta = vectors[..., 0], 1e-4
    turned = RotationHead("procrustes").decode((code + delta * R @ hat(axis)).flatten(-2))
    expected = 2 * delta / (values[:, 1] + values[:, 2])
    assert (geodesic_distance(turned, R) / expected - 1).abs().max() < 1e-2


def test_many_octaves_are_rough() -> None:
    turned = TEST @ axis_angle_to_matrix(torch.tensor([1e-3, 0, 0]))
    steps = []
    for octaves in (4, 10):
        torch.manual_seed(0)
        codec = RotationCodec(octaves)
        steps.append((codec.encode(turned) - codec.encode(TEST)).norm(dim=-1).mean())
    assert steps[1] > 5 * steps[0]


def test_file(codec: RotationCodec, tmp_path: Path) -> None:
    path = tmp_path / "codec.safetensors"
    save_codec(codec, path)
    assert path.stat().st_size < 120_000
    loaded = load_codec(str(path))
    assert (loaded.octaves, loaded.width) == (4, 128)
    assert digest(loaded) == digest(codec)
    assert torch.equal(loaded.encode(TEST), codec.encode(TEST))
    assert not any(p.requires_grad for p in loaded.parameters())
    save_codec(loaded, path)  # over the old one
    assert [p.name for p in tmp_path.iterdir()] == ["codec.safetensors"]


def test_a_file_is_written_whole_or_not_at_all(
    small: RotationCodec, codec: RotationCodec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "codec.safetensors"
    save_codec(small, path)

    def no_space(descriptor: int) -> None:
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", no_space)
        with pytest.raises(OSError, match="no space"):
            save_codec(codec, path)
    assert digest(load_codec(path)) == digest(small)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("cut", [0, 5, 100, -1])
def test_a_damaged_file_is_named(small: RotationCodec, tmp_path: Path, cut: int) -> None:
    path = tmp_path / "codec.safetensors"
    save_codec(small, path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ValueError, match=r"^path: expected .* save_codec .*, got .*codec\.safet"):
        load_codec(path)


def test_a_flipped_bit_is_named(small: RotationCodec, tmp_path: Path) -> None:
    path = tmp_path / "codec.safetensors"
    save_codec(small, path)
    data = bytearray(path.read_bytes())
    data[-9] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"^path: expected .*codec\.safetensors \(other weights"):
        load_codec(path)


def broken(**changes: torch.Tensor | None) -> dict[str, torch.Tensor]:
    weights = {**RotationCodec(1, 8).state_dict(), **changes}
    return {name: tensor for name, tensor in weights.items() if tensor is not None}


@pytest.mark.parametrize(
    "weights",
    [
        {},
        {"other": torch.ones(3)},
        broken(**{"mlp.2.bias": None}),
        broken(extra=torch.ones(1)),
        broken(**{"project.weight": torch.ones(8)}),
        broken(**{"project.weight": torch.ones(8, 17)}),
        broken(**{"project.weight": torch.ones(8, 19)}),
        broken(**{"project.weight": torch.ones(8, 18 * 11)}),
        broken(**{"mlp.0.weight": torch.ones(8, 9)}),
        broken(**{"mlp.2.bias": torch.full((9,), torch.nan)}),
    ],
)
def test_a_file_of_something_else_is_refused(weights: dict, tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    safetensors.torch.save_file(weights, path)
    with pytest.raises(ValueError, match="^path: expected .*, got "):
        load_codec(path)


def test_no_file(tmp_path: Path, small: RotationCodec) -> None:
    with pytest.raises(FileNotFoundError):
        load_codec(tmp_path / "none")
    with pytest.raises(FileNotFoundError):
        save_codec(small, tmp_path / "none" / "codec")


def test_autocast_leaves_the_target_as_it_is(codec: RotationCodec) -> None:
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = codec.encode(TEST)
    assert inside.dtype == torch.float32
    assert torch.equal(inside, codec.encode(TEST))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (0,)])
def test_any_batch_and_arrays(small: RotationCodec, batch: tuple) -> None:
    R = TEST[: int(np.prod(batch))].reshape(*batch, 3, 3)
    assert small.encode(R).shape == (*batch, 9)
    assert small(R).shape == R.shape
    assert small.spectrum(R).shape == (*batch, 3)
    assert isinstance(small(R.numpy()), np.ndarray)
    assert np.array_equal(small.encode(R.numpy()), small.encode(R).detach().numpy())


@pytest.mark.slow
@given(st.integers(0, 2**31), st.integers(1, 10), st.integers(1, 20))
def test_a_codec_of_any_size(seed: int, octaves: int, width: int) -> None:
    codec = train_codec(seed=seed, steps=1, batch=2, octaves=octaves, width=width)
    R = random_rotations(3, generator=seed, dtype=torch.float64)
    decoded = codec(R)
    assert (decoded @ decoded.mT - torch.eye(3)).abs().max() < 1e-13
    assert (codec.encode(R[1]) - codec.encode(R)[1]).abs().max() < 1e-5
    spectrum, code = codec.spectrum(R), codec.encode(R).unflatten(-1, (3, 3))
    assert (spectrum[:, :-1] >= spectrum[:, 1:].abs()).all()
    assert (spectrum.prod(-1) - torch.linalg.det(code)).abs().max() < 1e-12  # negative for some
    with tempfile.TemporaryDirectory() as folder:
        save_codec(codec, Path(folder) / "codec")
        loaded = load_codec(Path(folder) / "codec")
    assert digest(loaded) == digest(codec)


BAD = [
    (lambda: RotationCodec(octaves=0), "octaves"),
    (lambda: RotationCodec(octaves=11), "octaves"),
    (lambda: RotationCodec(octaves=2.5), "octaves"),
    (lambda: RotationCodec(width=0), "width"),
    (lambda: RotationCodec().encode(2 * torch.eye(3)), "R"),
    (lambda: RotationCodec().spectrum(torch.zeros(3, 3)), "R"),
    (lambda: train_codec(seed=-1), "seed"),
    (lambda: train_codec(seed=0.5), "seed"),
    (lambda: train_codec(seed=2**64), "seed"),
    (lambda: train_codec(seed=0, steps=0), "steps"),
    (lambda: train_codec(seed=0, batch=0), "batch"),
    (lambda: train_codec(seed=0, learning_rate=0), "learning_rate"),
    (lambda: train_codec(seed=0, learning_rate=np.nan), "learning_rate"),
    (lambda: train_codec(seed=0, loss="output"), "loss"),
    (lambda: train_codec(seed=0, octaves=32), "octaves"),
    (lambda: train_codec(seed=0, width="128"), "width"),
]


@pytest.mark.parametrize(("call", "name"), BAD)
def test_bad_input(call: Callable, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name}: expected .*, got "):
        call()
