"""The switch: what is in force, what is refused, and where caches lie on three systems."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecore import scale as module
from posecore.scale import SCALES, cache_folder, choose, retrain, scale

VARIABLES = ("SCALE", "CACHE", "RETRAIN")


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(f"POSECORE_{name}", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("LOCALAPPDATA", raising=False)


def test_the_scale_is_book_until_another_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    assert scale() == "book"
    monkeypatch.setenv("POSECORE_SCALE", "")
    assert scale() == "book"
    for name in ("tiny", "book", "paper"):
        monkeypatch.setenv("POSECORE_SCALE", name)
        assert scale() == name


def test_choose_takes_the_value_of_the_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose(tiny=1, book=2, paper=3) == 2
    for name, value in (("tiny", 1), ("book", 2), ("paper", 3)):
        monkeypatch.setenv("POSECORE_SCALE", name)
        assert choose(tiny=1, book=2, paper=3) == value
    with pytest.raises(TypeError, match="paper"):
        choose(tiny=1, book=2)


@given(st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), min_size=1))
def test_every_other_name_is_refused(name: str) -> None:
    if name in SCALES:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_SCALE", name)
        for call in (scale, lambda: choose(tiny=1, book=2, paper=3)):
            with pytest.raises(ValueError) as caught:
                call()
            expected = f"POSECORE_SCALE: expected one of tiny, book, paper, got {name!r}"
            assert str(caught.value) == expected


@pytest.mark.parametrize("name", ["Book", "TINY", " book", "tiny ", "0"])
def test_a_scale_is_written_exactly(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSECORE_SCALE", name)
    with pytest.raises(ValueError, match="POSECORE_SCALE"):
        scale()


def test_retrain(monkeypatch: pytest.MonkeyPatch) -> None:
    assert retrain() is False
    for text, answer in (("", False), ("0", False), ("1", True)):
        monkeypatch.setenv("POSECORE_RETRAIN", text)
        assert retrain() is answer
    monkeypatch.setenv("POSECORE_RETRAIN", "yes")
    with pytest.raises(ValueError, match="^POSECORE_RETRAIN: expected 0 or 1, got 'yes'$"):
        retrain()


def test_the_cache_is_where_the_variable_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path / "new"))
    assert cache_folder() == tmp_path / "new"
    assert not (tmp_path / "new").exists()
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    monkeypatch.setenv("POSECORE_CACHE", "~/mine")
    assert cache_folder() == tmp_path / "mine"


def test_a_cache_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSECORE_CACHE", "some/folder")
    with pytest.raises(ValueError, match="^POSECORE_CACHE: expected an absolute path, got 'some"):
        cache_folder()
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("POSECORE_CACHE", str(file))
    with pytest.raises(ValueError, match="^POSECORE_CACHE: expected a folder, got the file "):
        cache_folder()


@pytest.mark.parametrize("given", ["~nosuchuser/x", "/" + 300 * "a"])
def test_a_cache_of_nobody(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSECORE_CACHE", given)
    with pytest.raises(ValueError, match=f"^POSECORE_CACHE: expected .*{given[:20]}"):
        cache_folder()


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(module.Path, "home", nobody)
    for platform in ("linux", "darwin", "win32"):
        monkeypatch.setattr(module.sys, "platform", platform)
        with pytest.raises(ValueError, match="^POSECORE_CACHE: expected an absolute path, as this"):
            cache_folder()


@pytest.mark.parametrize(
    ("platform", "variable", "default"),
    [
        ("linux", "XDG_CACHE_HOME", ".cache"),
        ("win32", "LOCALAPPDATA", "AppData/Local"),
        ("darwin", None, "Library/Caches"),
    ],
)
def test_the_default_cache(
    platform: str,
    variable: str | None,
    default: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module.sys, "platform", platform)
    monkeypatch.setattr(module.Path, "home", lambda: tmp_path)
    assert cache_folder() == tmp_path / default / "posecore"
    if variable:
        monkeypatch.setenv(variable, "relative")
        assert cache_folder() == tmp_path / default / "posecore"
        monkeypatch.setenv(variable, str(tmp_path / "elsewhere"))
        assert cache_folder() == tmp_path / "elsewhere" / "posecore"
