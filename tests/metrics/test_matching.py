"""Which rows belong together. (What comes of it is tested in test_evaluation.)"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posecore.metrics.matching import each_with_each

sizes = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=4)


@given(sizes)
def test_every_row_of_an_image_meets_every_other_once(shapes):
    images, used = [], 0
    for d, g in shapes:
        images.append((np.arange(d) + used, np.arange(g) + 100 + used))
        used += 10
    one, other, apart = each_with_each(images)
    pairs = list(zip(one.tolist(), other.tolist(), strict=True))
    assert pairs == [(i, j) for est, gt in images for i in est.tolist() for j in gt.tolist()]
    grids = apart(1000 * one + other)
    assert [grid.shape for grid in grids] == shapes
    for grid, (est, gt) in zip(grids, images, strict=True):
        np.testing.assert_array_equal(grid, 1000 * est[:, None] + gt)
