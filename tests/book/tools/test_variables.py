import os

import pytest

from book.tools.variables import variables

NAMES = ("POSECORE_TEST_A", "POSECORE_TEST_B", "POSECORE_TEST_C")


@pytest.fixture
def before(monkeypatch):
    """A is set, and B and C are not."""
    monkeypatch.setenv(NAMES[0], "a")
    for name in NAMES[1:]:
        monkeypatch.delenv(name, raising=False)
    return "a", None, None


def now():
    return tuple(os.environ.get(name) for name in NAMES)


def test_variables_are_set_and_put_back(before):
    with variables({NAMES[0]: None, NAMES[1]: "b", NAMES[2]: ""}):
        assert now() == (None, "b", "")
        with variables({NAMES[1]: "deeper", NAMES[0]: "there"}):
            assert now() == ("there", "deeper", "")
        assert now() == (None, "b", "")
    assert now() == before


def test_they_are_put_back_after_an_error_and_whatever_happened_within(before):
    with pytest.raises(KeyError), variables({NAMES[0]: "other", NAMES[1]: None}):
        del os.environ[NAMES[0]]
        os.environ[NAMES[1]] = "left behind"
        raise KeyError
    assert now() == before


def test_others_are_left_alone(before):
    with variables({NAMES[0]: "other"}):
        os.environ[NAMES[2]] = "set by somebody else"
    assert now() == ("a", None, "set by somebody else")
    del os.environ[NAMES[2]]
