import numpy as np
import pytest

from data_tools.renderer import prepare, render_labels
from data_tools.shapes import GLASSES, PIVOT, make_subject
from data_tools.worlds.films import film
from data_tools.worlds.headset import cameras
from posecore import metrics
from posecore.poses import from_matrix, relative

pytestmark = pytest.mark.slow

SIZE = (48, 28)


@pytest.fixture(scope="module")
def night() -> tuple[np.ndarray, np.ndarray]:
    return film(3, 2, 12, np.random.default_rng(1), size=SIZE)


def test_the_same_seed_gives_the_same_film_and_another_seed_another(night):
    images, rotations = night
    again = film(3, 2, 12, np.random.default_rng(1), size=SIZE)
    assert np.array_equal(images, again[0]) and np.array_equal(rotations, again[1])
    other = film(3, 2, 12, np.random.default_rng(2), size=SIZE)
    assert not np.array_equal(images, other[0]) and not np.allclose(rotations, other[1])


def test_pictures_and_rotations_are_what_they_are_said_to_be(night):
    images, rotations = night
    assert images.shape == (12, 28, 48) and images.dtype == np.uint8
    assert 10 < images.max() and images[:, 0].mean() < images.mean()  # it is dark above the head
    np.testing.assert_allclose(rotations @ rotations.mT, np.tile(np.eye(3), (12, 1, 1)), atol=1e-12)


def test_bright_pixels_are_where_the_head_is_in_its_rotation(night):
    images, rotations = night
    K, T = cameras(*SIZE)[1]
    head = prepare(make_subject(3).head)
    for image, R in zip(images, rotations, strict=True):
        pose = relative(*from_matrix(T), R, PIVOT - R @ PIVOT)
        mask = render_labels([head], [pose], K, SIZE).instance == 0
        assert image[mask].mean() > 4 * image[~mask].mean()


def test_neighbours_in_time_are_alike_and_the_head_moves_in_the_long_run():
    _, rotations = film(0, 1, 90, np.random.default_rng(5), size=(8, 6))
    step = metrics.rotation_error(rotations[1:], rotations[:-1])
    assert np.degrees(step).mean() < 3
    assert np.degrees(metrics.rotation_error(rotations, rotations[:1])).max() > 15


def test_at_a_higher_rate_neighbours_are_more_alike():
    steps = []
    for rate, frames in ((10, 60), (60, 360)):
        _, rotations = film(0, 1, frames, np.random.default_rng(5), size=(8, 6), rate=rate)
        steps.append(metrics.rotation_error(rotations[1:], rotations[:-1]).mean())
    assert steps[1] < 0.4 * steps[0]


@pytest.mark.parametrize(
    ("arguments", "options", "named"),
    [
        ((-1, 1, 2), {}, "subject"),
        ((0, 0, 2), {}, "glasses"),
        ((0, len(GLASSES) + 1, 2), {}, "glasses"),
        ((0, 1.5, 2), {}, "glasses"),
        ((0, 1, 0), {}, "frames"),
        ((0, 1, 2), {"rate": 0}, "rate"),
        ((0, 1, 2), {"rate": float("nan")}, "rate"),
        ((0, 1, 2), {"size": (0, 10)}, "width"),
        ((0, 1, 2), {"size": (10, 2.5)}, "height"),
        ((0, 1, 2), {"size": 10}, "size"),
        ((0, 1, 2), {"size": (10, 10, 10)}, "size"),
    ],
)
def test_bad_input_is_named(arguments, options, named):
    with pytest.raises(ValueError, match=named):
        film(*arguments, np.random.default_rng(0), **options)


def test_a_generator_is_required():
    with pytest.raises(ValueError, match="generator"):
        film(0, 1, 2, 0)
