"""What is known of an object: derived, checked, and keypoints among its points."""

import numpy as np
import pytest

from posecore.models import ObjectModel, model_keypoints, require_models

POINTS = np.random.default_rng(0).normal(size=(30, 3)) * [0.1, 0.05, 0.02]
KEYPOINTS = POINTS[:5]
HALF_TURN = np.stack([np.eye(4), np.diag([-1.0, -1, 1, 1])])


def test_the_box_is_that_of_the_points_unless_it_is_given():
    model = ObjectModel(1, POINTS, 0.3)
    np.testing.assert_array_equal(model.size, np.ptp(POINTS, 0))
    np.testing.assert_allclose(model.centre, (POINTS.min(0) + POINTS.max(0)) / 2)
    assert model.keypoints is None and not model.symmetric
    other = ObjectModel(1, POINTS.tolist(), 0.3, centre=[1, 2, 3], size=[0, 1, 1])
    assert other.centre.tolist() == [1, 2, 3] and other.size.tolist() == [0, 1, 1]
    assert isinstance(other.points, np.ndarray)


def test_symmetric_is_what_has_another_pose():
    assert ObjectModel(1, POINTS, 0.3, symmetries=HALF_TURN).symmetric
    assert not ObjectModel(1, POINTS, 0.3, symmetries=HALF_TURN[:1]).symmetric


def test_keypoints_are_spread_points_and_the_centre_of_the_box():
    found = model_keypoints(POINTS, 6)
    assert found.shape == (7, 3)
    assert all((POINTS == point).all(1).any() for point in found[:-1])
    np.testing.assert_allclose(found[-1], ObjectModel(1, POINTS, 0.3).centre)
    first = np.linalg.norm(POINTS - found[-1], axis=1).argmax()
    np.testing.assert_array_equal(found[0], POINTS[first])


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"object_id": -1}, "object_id"),
        ({"object_id": 1.5}, "object_id"),
        ({"points": POINTS[:0]}, "points"),
        ({"points": POINTS * np.nan}, "points"),
        ({"diameter": 0}, "diameter"),
        ({"diameter": np.inf}, "diameter"),
        ({"keypoints": KEYPOINTS[:3]}, "keypoints"),
        ({"symmetries": np.eye(4)}, "symmetries"),
        ({"symmetries": 2 * HALF_TURN}, "symmetries"),
        ({"centre": [0, 0]}, "centre"),
        ({"size": [0, 0, np.nan]}, "size"),
    ],
)
def test_bad_input_is_named(changes, name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        ObjectModel(**({"object_id": 1, "points": POINTS, "diameter": 0.3} | changes))


def test_models_that_go_together():
    one, two = (ObjectModel(i, POINTS, 0.3, KEYPOINTS) for i in (1, 2))
    assert require_models((one, two)) == [one, two]
    bare, more = ObjectModel(3, POINTS, 0.3), ObjectModel(3, POINTS, 0.3, POINTS[:6])
    for models in ([], [one, None], [one, one], [one, bare], [bare], [one, more]):
        with pytest.raises(ValueError, match="^models: "):
            require_models(models)
