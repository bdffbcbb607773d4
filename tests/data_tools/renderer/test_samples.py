import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.renderer.samples import all_in_pixels, contrasting, one_per_pixel, refined
from data_tools.renderer.visibility import Scene, visibility


@pytest.fixture(scope="module")
def wall(make_triangles):
    """A slanted wall whose edge runs through the image."""
    return make_triangles(
        ((-9, -9, 1), (0.1, -9, 1), (0.1, 9, 3)), ((-9, -9, 1), (0.1, 9, 3), (-9, 9, 3))
    )


@given(st.integers(1, 5), st.integers(0, 99))
def test_a_refined_pixel_covers_the_same_place(n, seed):
    rng = np.random.default_rng(seed)
    K = np.array([[50.0, 1, 20], [0, 60, 15], [0, 0, 1]])
    scene = Scene([], [], K, (40, 30))
    fine = refined(scene, n)
    assert fine.size == (40 * n, 30 * n)
    point = np.array([*rng.uniform(-0.3, 0.3, 2), 1])
    # The border of the image, half a pixel outside the first centre, stays the border.
    np.testing.assert_allclose((fine.K @ point + 0.5)[:2], n * (K @ point + 0.5)[:2])


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(2, 3))
def test_samples_are_those_of_the_fine_image(make_scene, seed, n):
    scene = Scene(*make_scene(seed, size=(30, 20)))
    fine = visibility(refined(scene, n))
    blocks = fine.instance.reshape(20, n, 30, n).swapaxes(1, 2).reshape(20, 30, n * n)
    whole, samples = one_per_pixel(fine, n)
    same = (blocks == blocks[..., :1]).all(-1) & (blocks[..., 0] >= 0)
    assert (whole <= same).all()
    depths = fine.inverse_depth.reshape(20, n, 30, n).swapaxes(1, 2).reshape(20, 30, n * n)
    np.testing.assert_array_equal(whole, same & (np.ptp(depths, axis=-1) <= 0.05 * depths.max(-1)))
    np.testing.assert_array_equal(samples.instance, blocks[whole][:, 0])
    np.testing.assert_allclose(samples.inverse_depth, depths[whole].mean(1))
    np.testing.assert_array_equal((samples.y * 30 + samples.x).astype(int), np.flatnonzero(whole))

    pixel, every = all_in_pixels(fine, n, ~whole)
    np.testing.assert_array_equal(
        np.bincount(pixel, minlength=600), ((blocks >= 0).sum(-1) * ~whole).ravel()
    )
    column, row = (every.x + 0.5) * n - 0.5, (every.y + 0.5) * n - 0.5
    column, row = np.round(column).astype(int), np.round(row).astype(int)
    np.testing.assert_array_equal(pixel, row // n * 30 + column // n)
    np.testing.assert_array_equal(every.instance, fine.instance[row, column])
    np.testing.assert_array_equal(every.face, fine.face[row, column])
    np.testing.assert_array_equal(every.inverse_depth, fine.inverse_depth[row, column])


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_depth_of_a_plane_is_that_of_the_centre(wall, n):
    K = np.array([[40.0, 0, 19.5], [0, 40.0, 14.5], [0, 0, 1]])
    scene = Scene([wall], [(np.eye(3), np.array([0, 0, 1.0]))], K, (40, 30))
    whole, samples = one_per_pixel(visibility(refined(scene, n)), n)
    coarse = visibility(scene)
    both = whole & (coarse.instance == 0)
    assert both.sum() > 500
    np.testing.assert_allclose(
        samples.inverse_depth[both[whole]], coarse.inverse_depth[both], rtol=1e-9
    )


def test_contrast_is_seen_on_both_sides_and_only_between_whole_pixels():
    picture = np.full((6, 8, 3), 0.5, np.float32)
    picture[:, 4:] = 0.7
    whole = np.ones((6, 8), bool)
    whole[5] = False
    found = contrasting(picture, whole)
    expected = np.zeros((6, 8), bool)
    expected[:5, 3:5] = True
    np.testing.assert_array_equal(found, expected)
    assert not contrasting(picture * 0.01, whole).any()  # nobody sees the edges of the dark
    picture[:] = np.linspace(0.5, 0.6, 8)[:, None]
    assert not contrasting(picture, whole).any()
