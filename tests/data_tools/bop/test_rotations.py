import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_tools.bop.rotations import RotationWarning, check_rotations


def check(R, rotations="project"):
    return check_rotations("file.json", R, rotations, lambda i: f"row {i}")


def nearest(M):
    """Kabsch's answer, by numpy."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt


@given(seed=st.integers(0, 2**32), noise=st.sampled_from([0, 1e-15, 1e-9, 1e-7, 1e-5, 1e-4]))
def test_nearly_rotations_are_projected_silently(seed, noise):
    rng = np.random.default_rng(seed)
    R = Rotation.random(4, random_state=seed % 2**32).as_matrix()
    M = R + noise * rng.uniform(-1, 1, R.shape)
    result = check(M)
    np.testing.assert_allclose(result, [nearest(m) for m in M], atol=1e-14)
    np.testing.assert_allclose(result @ result.mT, np.tile(np.eye(3), (4, 1, 1)), atol=3e-15)
    assert np.array_equal(check(result), result), "what is a rotation must not change any more"
    assert np.array_equal(check(M, "as_read"), M)


def test_noticeable_ones_are_reported_once():
    R = Rotation.random(5, random_state=0).as_matrix()
    M = R.copy()
    M[1] *= 1.001
    M[3] *= 1.02
    with pytest.warns(RotationWarning) as record:
        result = check(M)
    assert len(record) == 1
    message = str(record[0].message)
    assert "file.json: 2 of 5 rotations" in message
    assert "up to 0.04" in message
    np.testing.assert_allclose(result, R, atol=1e-14)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(check(M, "as_read"), M)


def test_none_at_all():
    assert check(np.zeros((0, 3, 3))).shape == (0, 3, 3)


@pytest.mark.parametrize("rotations", ["project", "as_read"])
@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 1, -1]), "determinant -1"),
        (-np.eye(3), "determinant -1"),
        (np.zeros((3, 3)), "determinant 0"),
        (1e300 * np.eye(3), "up to inf and determinant inf"),
        (1.06 * np.eye(3), "up to 0.124"),
        (np.eye(3) * 0.001, "expected a rotation"),
        (np.ones((3, 3)), "expected a rotation"),
        ([[1, 0.2, 0], [0, 1, 0], [0, 0, 1]], "up to 0.2"),
    ],
)
def test_what_is_no_rotation_is_refused_by_row(rotations, matrix, message):
    R = np.tile(np.eye(3), (4, 1, 1))
    R[2] = matrix
    with pytest.raises(ValueError, match=rf"file\.json: row 2: .*{message}"):
        check(R, rotations)


def test_unknown_choice():
    with pytest.raises(ValueError, match="rotations: expected one of 'project', 'as_read'"):
        check(np.eye(3)[None], "round")
