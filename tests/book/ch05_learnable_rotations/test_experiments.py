"""What chapter 5 measures: tiny runs repeat themselves, and claims find both of their sides."""

import numpy as np
import pytest
import torch
from torch import nn

from book.ch05_learnable_rotations import experiments as page
from book.ch05_learnable_rotations import rotation_tables as tables
from book.ch05_learnable_rotations import rotations_seen as seen
from book.tools.contents import find_page
from book.tools.keys import Key, select
from posecore.cameras import project
from posecore.nets.rotation_heads import REPRESENTATIONS, RotationHead
from posecore.rotations import geodesic_distance, is_rotation, random_rotations
from posecore.training import fit, seeded
from tests.book.watching import watched_run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def results(shared_cache):
    """With seed 0."""
    chapter = find_page("05")
    return {name: watched_run(chapter, name, shared_cache).result for name in page.MEASUREMENTS}


def test_both_sides_of_every_claim_are_measured(results):
    ids = [claim.id for claim in page.CLAIMS]
    assert len(set(ids)) == len(ids) >= 15
    for claim in page.CLAIMS:
        assert {claim.favoured, claim.other} <= results[claim.measurement].keys(), claim.id
    assert {claim.measurement for claim in page.CLAIMS} == page.MEASUREMENTS.keys()


def test_numbers_are_degrees_or_percent_and_in_order(results):
    for numbers in results.values():
        assert all(0 <= value <= 180 for value in numbers.values())
    table = results["self_regression"]
    assert {key.method for key in table} == set(REPRESENTATIONS)
    for name in REPRESENTATIONS:
        parts = ("smallest", "percentile 50", "percentile 99", "largest")
        values = [table[Key(name, metric=f"rotation {part}")] for part in parts]
        mean = table[Key(name, metric="rotation")]
        assert values == sorted(values) and values[0] < mean < values[-1]
    for kind in ("from_images", "from_points"):
        for name in seen.FOUR:
            for split in ("easy", "occluded"):
                numbers = select(results[kind], method=name, split=split)
                near, far = (numbers[Key(name, split, f"rotation < {n} deg")] for n in (10, 20))
                assert len(numbers) == 4 and near <= far <= 100


def test_seeds_count_from_three_on():
    assert all(len(measured.seeds) >= 3 for measured in page.MEASUREMENTS.values())


@pytest.mark.parametrize("name", ["crossed_self_regression", "from_points", "from_images"])
def test_a_seed_repeats_itself_and_another_differs(results, name):
    function = page.MEASUREMENTS[name].function
    assert function(0) == results[name]
    assert function(1) != results[name]


def test_networks_side_by_side_are_trained_as_if_alone():
    heads = {name: RotationHead(name) for name in ("6d", "quaternion")}
    together, _ = tables.train_self_regression(heads, seed=1, steps=5)
    with seeded(1):
        alone = tables.mlp(6)
    fit(
        alone,
        lambda generator: random_rotations(256, generator=generator, dtype=torch.float32),
        lambda network, R: heads["6d"].loss(network(R), R).mean(),
        steps=5,
        lr=2e-3,
        seed=1,
        device="cpu",
        show=False,
    )
    for a, b in zip(alone.parameters(), together.networks["6d"].parameters(), strict=True):
        assert torch.allclose(a, b, atol=1e-6)


def test_networks_start_equal_but_for_their_last_layer():
    heads = {name: RotationHead(name) for name in ("6d", "quaternion")}
    networks = tables.SideBySide(heads, tables.mlp, seed=2).networks
    first, second = (list(network.parameters()) for network in networks.values())
    for a, b in zip(first[:-2], second[:-2], strict=True):
        assert torch.equal(a, b)
    assert first[-1].shape == (6,) and second[-1].shape == (4,)


def test_the_loss_is_the_sum_of_all():
    heads = {name: RotationHead(name) for name in ("6d", "procrustes", "euler")}
    networks = tables.SideBySide(heads, tables.mlp, seed=0)
    R = random_rotations(7, generator=0, dtype=torch.float32)
    parts = networks.losses(R, R)
    assert torch.isclose(parts.pop("loss"), sum(parts.values())) and parts.keys() == heads.keys()
    assert all(is_rotation(said).all() for said in networks(R).values())


def test_crossed_heads_are_those_of_the_table():
    heads = tables.crossed(tables.codec_of(0))
    assert len(heads) == 11 and set(seen.FOUR) <= heads.keys()
    for name, head in heads.items():
        assert name == f"{head.representation}, {head.loss_name}" and not head.squared
    assert all(head.squared for head in tables.table_iv(tables.codec_of(0)).values())


def test_errors_are_angles_in_degrees():
    class Says(nn.Module):
        def forward(self, inputs):
            return inputs

    heads = {"procrustes": RotationHead("procrustes")}
    networks = tables.SideBySide(heads, lambda size: Says(), seed=0)
    R, said = random_rotations(50, generator=0), random_rotations(50, generator=1)
    off = tables.degrees_off(networks, said.flatten(-2), R)["procrustes"]
    assert np.allclose(off, np.degrees(geodesic_distance(said, R).numpy()), atol=1e-9)


# Looking straight at the teapot -------------------------------------------------------------------


def test_facing_takes_rays_to_the_z_axis_by_the_smallest_turn():
    rays = np.random.default_rng(0).normal(size=(200, 3)) + [0, 0, 4]
    turn = seen.facing(rays)
    assert is_rotation(turn).all()
    length = np.linalg.norm(rays, axis=-1)
    assert np.allclose((turn @ rays[..., None])[..., 0], length[:, None] * [0, 0, 1])
    angle = np.arccos(rays[:, 2] / length)
    assert np.allclose(geodesic_distance(turn, np.eye(3)), angle, atol=1e-7)


def test_facing_straight_ahead_is_the_identity_with_a_gradient():
    rays = torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64, requires_grad=True)
    turn = seen.facing(rays)
    assert torch.allclose(turn, torch.eye(3, dtype=torch.float64))
    assert np.allclose(seen.facing(np.array([1e-9, 0, 1.0])), np.eye(3), atol=1e-8)


@pytest.mark.parametrize(
    ("rays", "words"), [(np.zeros((4, 2)), "rays"), ([0.0, np.nan, 1], "rays")]
)
def test_facing_names_bad_rays(rays, words):
    with pytest.raises(ValueError, match=words):
        seen.facing(rays)


def test_a_point_in_the_middle_stays_there_when_the_camera_faces_it():
    K = np.array([[300.0, 0, 60], [0, 310, 40], [0, 0, 1]])
    point = np.array([0.2, -0.1, 0.9])
    turned = (seen.facing(point) @ point)[None]
    assert np.allclose(project(K, turned), K[:2, 2])


def test_images_are_bytes_with_rotations():
    looks = seen.images("easy", 2)
    assert looks.inputs.dtype == torch.uint8 and looks.inputs.shape[1:] == (3, 64, 64)
    assert looks.R.shape == (len(looks.inputs), 3, 3) and is_rotation(looks.R).all()
    assert len(looks.R) % 2 == 0 and looks.inputs.float().std() > 10
    # The second look at a teapot is another one.
    half = len(looks.R) // 2
    assert not torch.equal(looks.R[:half], looks.R[half:])


def test_clouds_are_of_the_size_of_the_teapot():
    clouds = seen.clouds("train")
    assert clouds.inputs.shape[1:] == (512, 3) and is_rotation(clouds.R).all()
    assert torch.allclose(clouds.inputs.mean(1), torch.zeros(3), atol=1e-4)
    reach = clouds.inputs.norm(dim=-1).median()  # in units of 0.1 m, of an object of 0.23 m
    assert 0.2 < reach < 1.2


def test_a_cloud_and_its_rotation_turn_together():
    clouds = seen.clouds("train")
    rows = torch.arange(4)
    turned = seen.varied(clouds, rows, torch.Generator().manual_seed(0), hide=0)
    assert turned.inputs.shape == (4, seen.POINTS, 3)
    # In the object's frame the same points are found again, but for a shift that all share.
    before, after = clouds.inputs[rows] @ clouds.R[rows], turned.inputs @ turned.R
    for one, other in zip(before, after, strict=True):
        shifts = one[None] - other[:2, None]  # (2, 512, 3) of the first two points
        assert torch.cdist(*shifts).min() < 1e-4


def test_hiding_takes_points_of_one_side():
    x = torch.linspace(-1, 1, 512)
    line = torch.stack([x, 0 * x, 0 * x], -1)[None]
    cloud = seen.Seen(line, torch.eye(3)[None])
    for number in range(20):
        generator = torch.Generator().manual_seed(number)
        part = seen.varied(cloud, torch.zeros(1, dtype=torch.long), generator, hide=0.4)
        length = (part.inputs[0, :, None] - part.inputs[0]).norm(dim=-1).max()
        assert 1.1 < length <= 2.0  # at the least 60 % of 2


def test_the_order_of_points_does_not_matter():
    with seeded(0):
        network = seen.PointNet(9).eval()
    points = torch.randn(3, 50, 3)
    mixed = points[:, torch.randperm(50)]
    assert torch.allclose(network(points), network(mixed), atol=1e-6)
    assert network(points).shape == (3, 9)
    assert seen.conv_net(4).eval()(torch.rand(2, 3, 64, 64)).shape == (2, 4)
