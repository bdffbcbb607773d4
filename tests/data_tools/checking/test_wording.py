from dataclasses import replace

import pytest

from data_tools.checking import wording
from data_tools.checking.corrections import AS_GIVEN, pose_corrections
from data_tools.checking.fits import rescaled


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (1000, "1000 times too large (millimetres taken for metres)"),
        (1 / 1000, "1000 times too small (metres taken for millimetres)"),
        (999, "1000 times too large (millimetres taken for metres)"),
        (25.4, "25.4 times too large (millimetres taken for inches)"),
        (0.1, "10 times too small (centimetres taken for millimetres)"),
        (1.25, "1.25 times too large"),
        (1 / 3, "3 times too small"),
    ],
)
def test_too_large(ratio, words):
    assert wording.too_large(ratio) == words
    assert words.startswith(wording.times(ratio))


def test_scales_in_words():
    """A factor above 1 makes models larger: they are too small, or translations too large."""
    unit, mesh = rescaled(AS_GIVEN, 1000), rescaled(AS_GIVEN, 1.25)
    key, words, remedy = wording.scale_words(unit, "models")
    assert key == "scaled models" and remedy == "models times 1000"
    assert words == "the models are 1000 times too small (metres taken for millimetres)"
    key, words, remedy = wording.scale_words(unit, "translations")
    assert key == "scaled translations" and remedy == "translations times 0.001"
    assert words == "the translations are 1000 times too large (millimetres taken for metres)"
    key, words, remedy = wording.scale_words(mesh, None)
    assert key == "scale" and remedy == "models times 1.25"
    assert words == (
        "the models are 1.25 times too small: a scaled mesh, or the translations are 1.25 times "
        "too large: without depth one cannot tell"
    )


def test_two_mistakes_in_words(sample):
    (flipped,) = (c for c in pose_corrections(sample) if c.key == "flipped axes")
    key, words, remedy = wording.scale_words(rescaled(flipped, 1000), "models")
    assert key == "flipped axes and scaled models"
    assert words.startswith(f"{flipped.mistake}; and the models are 1000 times too small")
    assert remedy == f"{flipped.remedy}, models times 1000"


def test_all_lengths():
    key, words, remedy = wording.all_lengths(1003.0)
    assert key == "scaled models and translations" and remedy == "both times 1000"
    assert words.startswith("models and translations are 1000 times too small")


def test_what_is_plausible(sample):
    """Objects of 20 cm at a metre."""
    instances = sample.instances
    assert wording.sizes_plausible(instances)
    assert not wording.sizes_plausible(instances, 1e-3)
    far = [replace(i, item=replace(i.item, t=i.item.t * 1000)) for i in instances]
    assert wording.plausible_owner(far, 1000) == "translations"
    near = [replace(i, item=replace(i.item, t=i.item.t / 1000)) for i in instances]
    assert wording.plausible_owner(near, 1 / 1000) == "translations"
    assert wording.plausible_owner(instances, 1.2) is None
