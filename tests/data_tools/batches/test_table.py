"""The table of what is known of views and objects, which batches are cut from."""

import numpy as np
import pytest
import torch

from tests.data_tools.batches.conftest import load, make_view

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("world", ["categories", "headset", "tabletop"])
def test_the_table_is_that_of_the_views(world, stack_of, views_of):
    stack, views = stack_of(world), views_of(world)
    objects = [item for view in views for item in view.objects]
    assert len(stack) == len(views) and len(stack.R) == len(objects)
    assert np.array_equal(stack.K, [view.K for view in views])
    assert np.array_equal(stack.T_world_cam, [view.T_world_cam for view in views])
    assert stack.scene_id.tolist() == [view.scene_id for view in views]
    assert stack.image_id.tolist() == [view.image_id for view in views]
    assert stack.view.tolist() == [i for i, view in enumerate(views) for _ in view.objects]
    for name in ("R", "t", "visible_fraction"):
        assert np.array_equal(getattr(stack, name), [getattr(item, name) for item in objects])
    assert np.array_equal(stack.object_size, [item.size for item in objects])
    assert stack.object_id.tolist() == [item.object_id for item in objects]
    if stack.categories is not None:
        names = [stack.categories[i] for i in stack.category]
        assert names == [item.category for item in objects]
    pairs = {(view.group, int(number)) for view, number in zip(views, stack.group, strict=True)}
    assert len(pairs) == len({view.group for view in views}) == int(stack.group.max()) + 1


def test_rows(stack_of):
    stack = stack_of("tabletop")
    rows = stack.rows(object_id=[1, 5], visible=0.7)
    assert 0 < len(rows) < len(stack.view)
    expected = torch.isin(stack.object_id, torch.tensor([1, 5])) & (stack.visible_fraction >= 0.7)
    assert torch.equal(rows, expected.nonzero()[:, 0])
    assert torch.equal(stack.rows(object_id=1), stack.rows(object_id=[1]))
    named = stack_of("categories")
    mugs = named.rows(category="mug")
    assert [named.categories[i] for i in named.category[mugs]] == ["mug"] * len(mugs)


STACK = load([make_view(i, 2) for i in range(3)])
UNEVEN = load([make_view(i, group=f"instant {i // 2}") for i in range(3)])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: STACK.rows(category="mug"), "category"),
        (lambda: STACK.rows(visible=0.5), "visible"),
        (lambda: STACK.rows(visible=2), "visible"),
        (lambda: STACK.rows(object_id="cat"), "object_id"),
        (lambda: UNEVEN.groups, "groups"),
    ],
)
def test_bad_input(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
