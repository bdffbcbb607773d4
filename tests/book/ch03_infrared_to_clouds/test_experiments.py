"""What chapter 03 measures."""

import pytest

from book.ch03_infrared_to_clouds import experiments

pytestmark = pytest.mark.slow


def test_a_seed_repeats_itself_and_another_differs():
    numbers = experiments.whole_images(0)
    assert numbers == experiments.whole_images(0) != experiments.whole_images(1)
    for claim in experiments.CLAIMS:
        assert {claim.favoured, claim.other} <= numbers.keys()
