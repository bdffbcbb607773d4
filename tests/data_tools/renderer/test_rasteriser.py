import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.renderer import rasterise

EYE = np.eye(3)
K = np.array([[40.0, 0, 19.5], [0, 40.0, 14.5], [0, 0, 1]])
SIZE = (40, 30)


def grid(size, margin=0):
    """Columns and rows of all pixels of an image, and of as many images around it."""
    width, height = size
    y, x = np.mgrid[
        -margin * height : (1 + margin) * height, -margin * width : (1 + margin) * width
    ]
    return x.ravel(), y.ravel()


def image_of(buffer, size):
    """Depth (infinite for none) and face of a buffer, in the whole image."""
    depth = np.full(size[::-1], np.inf)
    face = np.full(size[::-1], -1)
    if buffer is not None:
        window = buffer.window
        depth[window][buffer.mask] = 1 / buffer.inverse_depth[buffer.mask]
        face[window][buffer.mask] = buffer.face[buffer.mask]
    return depth, face


@pytest.mark.slow
@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_agrees_with_rays(make_scene, cast_rays, seed):
    objects, poses, camera, size = make_scene(seed, size=(24, 18), count=2)
    x, y = grid(size, margin=1)
    inside = (x >= 0) & (x < size[0]) & (y >= 0) & (y < size[1])
    for item, (R, t) in zip(objects, poses, strict=True):
        buffer = rasterise(item, R, t, camera, size)
        depth, face = image_of(buffer, size)
        expected, hit = cast_rays(item, R, t, camera, x, y)
        seen = np.isfinite(expected)
        if buffer is None:
            assert not seen.any()
            continue
        # All in float64: not a single pixel may differ.
        np.testing.assert_array_equal(np.isfinite(depth).ravel(), seen[inside])
        close = expected[inside & seen]
        np.testing.assert_allclose(depth[np.isfinite(depth)], close, rtol=1e-8)
        same = item.source[face[face >= 0]] == hit[inside & seen]
        assert same.mean() > 0.99 if len(same) else True  # two faces of an edge may tie
        assert buffer.full_pixels == seen.sum()
        corner = x[seen].min(), y[seen].min()
        extent = x[seen].max() - corner[0] + 1, y[seen].max() - corner[1] + 1
        assert buffer.full_box == (*corner, *extent)


def test_many_random_scenes_cut_the_near_plane_and_the_border(make_scene):
    """The scenes of the test above are of the kind that it is about."""
    cut = border = empty = 0
    for seed in range(30):
        objects, poses, camera, size = make_scene(seed, size=SIZE)
        for item, (R, t) in zip(objects, poses, strict=True):
            z = R[2] @ item.vertices + t[2]
            cut += z.min() < 0.01 < z.max()
            buffer = rasterise(item, R, t, camera, size)
            empty += buffer is None
            if buffer is not None:
                border += buffer.full_pixels > np.count_nonzero(buffer.keys)
    assert cut > 15 and border > 30 and 0 < empty < 60


def test_without_the_outside_only_the_count_differs(make_scene):
    objects, poses, camera, size = make_scene(3)
    for item, (R, t) in zip(objects, poses, strict=True):
        one = rasterise(item, R, t, camera, size)
        other = rasterise(item, R, t, camera, size, outside=False)
        if one is None or not one.keys.size:
            assert other is None or not other.keys.size
            continue
        assert other.keys.tobytes() == one.keys.tobytes()
        assert other.full_pixels == np.count_nonzero(one.keys)


def test_behind_the_camera_there_is_nothing(shapes):
    assert rasterise(shapes[0], EYE, np.array([0, 0, -1.0]), K, SIZE) is None
    assert rasterise(shapes[0], EYE, np.array([0, 0, -0.05]), K, SIZE) is None


def test_beside_the_image_it_is_counted_but_not_drawn(shapes):
    buffer = rasterise(shapes[0], EYE, np.array([0.4, 0, 0.5]), K, SIZE)
    assert buffer.keys.size == 0 and buffer.full_pixels > 10 and buffer.full_box[0] >= SIZE[0]
    assert rasterise(shapes[0], EYE, np.array([0.4, 0, 0.5]), K, SIZE, outside=False) is None
    assert rasterise(shapes[0], EYE, np.array([9.0, 0, 0.5]), K, SIZE) is None


def test_larger_than_the_image(make_triangles):
    wall = make_triangles(((-99, -99, 1), (99, -99, 1), (0, 99, 1)))
    buffer = rasterise(wall, EYE, np.zeros(3), K, SIZE)
    assert buffer.keys.shape == SIZE[::-1] and (buffer.inverse_depth > 0).all()
    assert buffer.full_pixels == 9 * SIZE[0] * SIZE[1]
    assert buffer.full_box == (-40, -30, 120, 90)


@pytest.mark.parametrize("k", [0, 2])
def test_from_inside_one_sees_the_inside(shapes, cast_rays, k):
    item = shapes[k]
    buffer = rasterise(item, EYE, np.zeros(3), K, SIZE)
    depth, _ = image_of(buffer, SIZE)
    expected, _ = cast_rays(item, EYE, np.zeros(3), K, *grid(SIZE))
    np.testing.assert_allclose(depth.ravel(), expected, rtol=1e-8)
    assert np.isfinite(depth).all()


def test_one_pixel(make_triangles):
    small = 0.4 / 40
    speck = make_triangles(((-small, -small, 1), (small, -small, 1), (0, small, 1)))
    t = np.array([0.5 / 40, 0.5 / 40, 0])
    buffer = rasterise(speck, EYE, t, K, SIZE)
    assert (buffer.x, buffer.y, buffer.keys.shape, buffer.full_pixels) == (20, 15, (1, 1), 1)
    assert buffer.inverse_depth.item() == pytest.approx(1)
    assert rasterise(speck, EYE, np.zeros(3), K, SIZE) is None  # it lies between four centres


def test_edge_on_there_is_nothing(make_triangles):
    plate = make_triangles(((-1, 0, 1), (1, 0, 1), (0, 0, 3)))
    assert rasterise(plate, EYE, np.zeros(3), K, SIZE) is None
    assert rasterise(plate, EYE, np.array([0, 0, -2.0]), K, SIZE) is None  # and cut
    # The camera is 0.1 nm from this plane, whose picture is thinner than light, but on a row.
    camera = K + [[0, 0, 0], [0, 0, 0.5], [0, 0, 0]]
    for back in (3, -3):
        thin = make_triangles(((-1, -1e-10, 1), (1, -1e-10, 1), (0, 1e-10, back)))
        assert rasterise(thin, EYE, np.zeros(3), camera, SIZE) is None


def test_backs_are_seen_of_open_parts_only(make_triangles):
    corners = ((-1, -1, 1), (1, -1, 1), (0, 1, 1))
    for closed in (False, True):
        facing = make_triangles(corners[::-1], closed=closed)
        turned = make_triangles(corners, closed=closed)
        seen = [rasterise(item, EYE, np.zeros(3), K, SIZE) for item in (facing, turned)]
        assert seen[0] is not None
        assert (seen[1] is None) == closed


def test_a_mesh_without_faces(make_triangles):
    assert rasterise(make_triangles(), EYE, np.zeros(3), K, SIZE) is None


def test_the_near_plane_can_be_moved(shapes, cast_rays):
    t = np.array([0, 0, 0.5])
    for near in (0.44, 0.48, 0.55):
        depth, _ = image_of(rasterise(shapes[0], EYE, t, K, SIZE, near=near), SIZE)
        expected, _ = cast_rays(shapes[0], EYE, t, K, *grid(SIZE), near)
        np.testing.assert_allclose(depth.ravel(), expected, rtol=1e-8)


def test_a_mirrored_camera(shapes, cast_rays):
    camera = K * [[-1, 1, 1], [1, 1, 1], [1, 1, 1]]
    t = np.array([0.05, 0.02, 0.4])
    depth, _ = image_of(rasterise(shapes[5], EYE, t, camera, SIZE), SIZE)
    expected, _ = cast_rays(shapes[5], EYE, t, camera, *grid(SIZE))
    np.testing.assert_allclose(depth.ravel(), expected, rtol=1e-8)
