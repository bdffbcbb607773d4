import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_tools.renderer.shadows import ShadowMap, shadow_map

EYE = (np.eye(3), np.zeros(3))
LAMP = np.array([0.1, -0.2, 0.0])
FLOOR = 1.0  # depth of a wall that faces the camera


def triple(array):
    return tuple(np.asarray(array, np.float32).T)


def wall_points(z=FLOOR, n=160, reach=0.4):
    x, y = np.meshgrid(*[np.linspace(-reach, reach, n)] * 2)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], 1)


def facing(points):
    return triple(np.tile([0.0, 0, -1], (len(points), 1)))


def plate(make_triangles, half=0.1, z=0.7):
    a, b, c, d = (-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)
    return make_triangles((a, b, c), (a, c, d))


def distance_to_square(points, half, z):
    """How far outside a square's shadow points of the wall lie, in metres on the wall."""
    at = LAMP[:2] + (points[:, :2] - LAMP[:2]) * (z - LAMP[2]) / (points[:, 2:] - LAMP[2])
    return (np.abs(at) - half).max(1) * (points[0, 2] - LAMP[2]) / (z - LAMP[2])


@pytest.mark.parametrize("radius", [0.0, 0.01])
def test_the_shadow_of_a_square_is_where_it_must_be(make_triangles, radius):
    points = wall_points()
    made = shadow_map([plate(make_triangles)], [EYE], LAMP, radius, triple(points), 512)
    lit = made.lit(triple(points), facing(points))
    away = distance_to_square(points, 0.1, 0.7)
    # The map has 512 texels for 0.2 m at 0.7: 0.6 mm on the wall, of which the filter takes 3; the
    # half-shadow of a lamp of 1 cm is 2 * 1 cm * 0.3 / 0.7 = 9 mm wide.
    soft = 0.0025 + radius * 0.3 / 0.7 * 2
    assert (lit[away > soft] > 1 - 1e-6).all()
    assert (lit[away < -soft] == 0).all()
    assert ((lit >= 0) & (lit <= 1 + 1e-6)).all() and lit.dtype == np.float32


@pytest.mark.parametrize("axis", [0, 1])
def test_shadows_are_soft_where_the_blocker_is_far(make_triangles, axis):
    widths = []
    for z in (0.95, 0.8, 0.6):
        line = np.zeros((4000, 3))
        line[:, axis], line[:, 2] = np.linspace(0, 0.4, 4000), FLOOR
        wide = np.concatenate([line, wall_points()])
        item = plate(make_triangles, z=z)
        made = shadow_map([item], [EYE], np.zeros(3), 0.02, triple(wide), 512)
        lit = made.lit(triple(line), facing(line))
        rim = line[(lit > 0.05) & (lit < 0.95), axis]
        widths.append(np.ptp(rim))
        assert rim.mean() == pytest.approx(0.1 / z, abs=0.004)
        # From dark to light, without a stair: never three times as steep as on the whole.
        assert (np.diff(lit) > -1e-3).all()
        assert np.diff(lit).max() < 3 * (0.4 / 4000) / widths[-1]
    expected = [0.04 * (1 - z) / z for z in (0.95, 0.8, 0.6)]
    assert widths[0] < widths[1] < widths[2]
    # 90 % of the way up, through a filter that is a box smoothed by its last third.
    np.testing.assert_allclose(widths, expected, rtol=0.5, atol=0.003)


@pytest.mark.parametrize("tilt", [0, 0.6, -1.0])
def test_soft_shadows_are_nearly_those_of_a_round_lamp(make_triangles, tilt):
    """Against the share of a disc from which the square does not hide the point."""
    radius, z = 0.03, 0.7
    c, s = np.cos(tilt), np.sin(tilt)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    points = wall_points(0, 120, 0.3) @ R.T + (0, 0, FLOOR)
    normals = triple(np.tile(-R[:, 2], (len(points), 1)))
    wall = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) @ R.T + (0, 0, FLOOR)
    wall = make_triangles(wall[[0, 2, 1]], wall[[0, 3, 2]])
    scene = [plate(make_triangles), wall], [EYE, EYE]
    made = shadow_map(*scene, np.zeros(3), radius, triple(points), 512)
    lit = made.lit(triple(points), normals)
    turn, out = np.meshgrid(np.arange(16) * np.pi / 8, np.sqrt((np.arange(8) + 0.5) / 8))
    lamps = radius * np.stack([out * np.cos(turn), out * np.sin(turn)], -1).reshape(-1, 2)
    at = lamps[:, None] + (points[:, :2] - lamps[:, None]) * z / points[:, 2:]
    expected = np.mean((np.abs(at) > 0.1).any(-1) | (points[:, 2] < z), axis=0)
    soft = (expected > 0) & (expected < 1)
    error = np.abs(lit - expected)
    # One width for each point, from the mean blocker, rounds corners; a box is not a disc.
    assert error[soft].mean() < 0.12 and error.max() < 0.4


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_no_acne_on_a_wall(make_triangles, seed):
    rng = np.random.default_rng(seed)
    lamp = np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-0.4, 0.3)])
    # A tilted wall that fills the picture, and throws shadows itself.
    R = Rotation.from_rotvec(rng.uniform(-0.8, 0.8, 3)).as_matrix()
    corners = np.array([[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0.0]])
    wall = make_triangles(corners[[0, 1, 2]], corners[[0, 2, 3]])
    pose = R, np.array([0, 0, 1.0])
    points = wall_points(0, 60) @ R.T + pose[1]
    normal = -R[:, 2] * np.sign(R[:, 2] @ (pose[1] - lamp))
    made = shadow_map([wall], [pose], lamp, 0.03, triple(points), 256)
    if made is not None:
        normals = triple(np.tile(normal, (len(points), 1)))
        ray = lamp - points
        slant = ray @ normal / np.linalg.norm(ray, axis=1)
        lit = made.lit(triple(points), normals)
        assert (lit[slant > 0.051] > 1 - 1e-6).all()  # weights sum to 1 in float32


def test_no_acne_on_a_ball(make):
    sphere = trimesh.creation.icosphere(4, 0.1)
    ball, centre = make(sphere), np.array([0, 0, 0.8])
    points = sphere.triangles_center + centre
    normals = np.asarray(sphere.face_normals)
    ray = LAMP - points
    slant = (ray * normals).sum(1) / np.linalg.norm(ray, axis=1)
    made = shadow_map([ball], [(np.eye(3), centre)], LAMP, 0.03, triple(points), 256)
    lit = made.lit(triple(points), triple(normals))
    assert (lit[slant > 0.15] > 0.99).all()
    assert (lit[slant <= 0] == 0).all()


def test_no_light_leaks_under_what_stands_on_the_floor(make):
    # A box on the wall z = 1, the lamp to its side: from its foot on the wall lies in shadow.
    box = make(trimesh.creation.box((0.1, 0.3, 0.1)), smooth=False)
    lamp = np.array([-0.6, 0, 0.5])
    x = np.linspace(0.051, 0.06, 40)
    points = np.stack([x, np.zeros(40), np.full(40, FLOOR)], 1)
    around = np.concatenate([points, wall_points()])
    made = shadow_map([box], [(np.eye(3), np.array([0, 0, 0.95]))], lamp, 0.02, triple(around), 512)
    lit = made.lit(triple(points), facing(points))
    assert lit.max() < 0.35 and (lit[10:] == 0).all()  # half a millimetre of the foot may blur


def test_low_things_throw_short_shadows(make, make_triangles):
    # A plate of 2.5 mm that lies on the wall; the lamp's light falls on it at 50 degrees.
    low = make(trimesh.creation.box((0.1, 0.3, 0.0025)), smooth=False)
    far = make_triangles(((0.2, -0.2, 0.9), (0.21, -0.2, 0.9), (0.2, -0.21, 0.9)))
    x = np.linspace(0.048, 0.058, 200)
    points = np.stack([x, np.zeros(200), np.full(200, FLOOR)], 1)
    points, around = points[x > 0.0505], np.concatenate([points, wall_points()])
    poses = [(np.eye(3), np.array([0, 0, 0.99875])), EYE]
    lamp = np.array([-0.6, 0, 0.5])
    made = shadow_map([low, far], poses, lamp, 0.01, triple(around), 512)
    lit = made.lit(triple(points), facing(points))
    assert lit[points[:, 0] < 0.0518].max() < 0.5 and lit[points[:, 0] > 0.0575].min() > 0.9


@pytest.mark.parametrize("gap", [0.02, 0.1, 0.3])
def test_thin_things_throw_whole_shadows(make_triangles, gap):
    # A bar of 3 mm, three texels wide in a map of things further apart, wherever its texels lie.
    z = FLOOR - gap
    far = np.array([[0.3, 0.3, z], [0.31, 0.3, z], [0.31, 0.31, z]])
    for y in np.linspace(0, 0.01, 9):
        bar = np.array([[-0.2, -0.0015, z], [0.2, -0.0015, z], [0.2, 0.0015, z], [-0.2, 0.0015, z]])
        bar += [0, y, 0]
        item = make_triangles(bar[[0, 1, 2]], bar[[0, 2, 3]], far, -far * (1, 1, -1))
        x = np.linspace(-0.15, 0.15, 600)
        points = np.stack([x / z, np.full(600, y / z), np.full(600, FLOOR)], 1)
        around = np.concatenate([points, wall_points()])
        made = shadow_map([item], [EYE], np.zeros(3), 0.001, triple(around), 512)
        lit = made.lit(triple(points), facing(points))
        assert lit.max() < 0.6 and np.ptp(lit) < 0.2


def test_no_map_where_no_shadow_can_fall(make_triangles):
    points = triple(wall_points())
    item = plate(make_triangles)
    assert shadow_map([], [], LAMP, 0, points, 64) is None
    assert shadow_map([item], [EYE], LAMP, 0, triple(np.zeros((0, 3))), 64) is None
    beside = (np.eye(3), np.array([1.0, 0, 0]))
    assert shadow_map([item], [beside], LAMP, 0, points, 64) is None


def test_a_lamp_inside_and_a_lamp_between(make_triangles):
    points = wall_points()
    for lamp in ((0, 0, 0.7), (0, 0, FLOOR), (0, 0, 1.5)):
        made = shadow_map([plate(make_triangles)], [EYE], np.array(lamp), 0.02, triple(points), 64)
        if made is not None:
            lit = made.lit(triple(points), facing(points))
            assert np.isfinite(lit).all() and ((lit >= 0) & (lit <= 1 + 1e-6)).all()


@given(st.integers(0, 2**32 - 1))
def test_any_map_gives_shares(seed):
    rng = np.random.default_rng(seed)
    inverse = rng.choice([0, 1.0, 2.0], (32, 32)) * rng.uniform(0.5, 1.5, (32, 32))
    K = np.array([[20.0, 0, 15.5], [0, 20, 15.5], [0, 0, 1]])
    made = ShadowMap(np.eye(3), np.zeros(3), K, inverse, rng.uniform(0, 0.2))
    points, normals = rng.normal(size=(2, 50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lit = made.lit(triple(points), triple(normals))
    assert lit.dtype == np.float32 and ((lit >= 0) & (lit <= 1 + 1e-6)).all()


@given(seed=st.integers(0, 2**32), radius=st.sampled_from([0.0, 0.03]))
def test_only_what_has_nothing_near_it_is_left_out_of_the_search(seed, radius):
    rng = np.random.default_rng(seed)
    K = np.array([[40.0, 0, 31.5], [0, 40, 31.5], [0, 0, 1]])
    blobs = rng.uniform(0.2, 3, (64, 64)) * (rng.random((64, 64)) < 0.005)
    made = ShadowMap(*EYE, K, blobs, radius)
    z = rng.uniform(0.3, 4, (2000, 1))
    points = z * np.hstack([rng.uniform(-0.75, 0.75, (2000, 2)), np.ones((2000, 1))])
    normals = rng.normal([0, 0, -3], 1, (2000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Of a plane that the light grazes, the part in the window reaches behind the lamp.
    steep = -(points * normals).sum(1) < 0.3 * np.linalg.norm(points, axis=1)
    p, n = triple(points[~steep]), triple(normals[~steep])
    lit = made.lit(p, n)
    left_out = made._penumbra(p, n) < 0
    assert left_out.any() and not left_out.all()
    made._window = np.full_like(made._window, np.inf)  # search everywhere
    # The weights of sixteen texels sum to 1 within a few steps of float32.
    np.testing.assert_allclose(made.lit(p, n), lit, atol=2e-6)
