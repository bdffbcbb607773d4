from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from data_tools.checking.sample import chosen_views, read_sample, spread_out
from tests.data_tools.checking.made import Made, sample_of


@given(length=st.integers(0, 500), count=st.integers(1, 60))
def test_views_are_chosen_all_over_and_have_neighbours(length, count):
    chosen = chosen_views(length, count)
    assert chosen == sorted(set(chosen)) and all(0 <= i < length for i in chosen)
    assert len(chosen) <= max(count, 3)
    if length <= count:
        assert chosen == list(range(length))
    elif length > 3:
        assert chosen[0] == 0 and (count < 6 or chosen[-1] == length - 1)
        assert all({i - 1, i + 1} & set(chosen) for i in chosen)


def test_spread_out():
    assert spread_out(3, 5) == [0, 1, 2]
    assert spread_out(9, 3) == [0, 4, 8]


def test_what_is_known_of_an_instance(made):
    sample = sample_of(made)
    assert sample.total == len(sample.instances) == 16
    for number, instance in enumerate(sample.instances):
        view = made[number // 2]
        assert (instance.number, instance.view, instance.row) == (number, number // 2, number % 2)
        item = view.objects[number % 2]
        assert instance.item is item and instance.object_id == item.object_id
        assert instance.size == (160, 120) and instance.depth is view.depth
        assert instance.mask is item.full_mask and instance.others is None and instance.step == 1
        y, x = np.nonzero(item.mask)
        inside = x.min() > 0 and x.max() < 159 and y.min() > 0 and y.max() < 119
        assert instance.whole == inside
        place = instance.place
        assert place.K is view.K and place.R is item.R and place.t is item.t and place.scale == 1


def test_where_others_are_is_unknown_of_what_is_seen(made):
    half = np.zeros((120, 160), bool)
    half[:, 80:] = True

    def cut(view):
        left, right = view.objects
        return replace(
            view,
            objects=[
                replace(left, mask=left.mask & ~half, full_mask=None),
                replace(right, mask=half, full_mask=None),
            ],
        )

    for left, right in zip(*[iter(sample_of(made.each(cut)).instances)] * 2, strict=True):
        assert np.array_equal(left.others, half & ~left.mask)
        assert np.array_equal(right.others, left.mask)
        touching = (left.mask[:, 79] & half[:, 80]).any()
        assert not (touching and left.whole)


def test_what_is_too_small_is_left_out(made):
    def shrink(item):
        mask = np.zeros_like(item.mask)
        mask[:4, : 6 if item.object_id == 3 else 7] = True
        return {"mask": mask, "full_mask": mask}

    assert {i.object_id for i in sample_of(made.items(shrink)).instances} == {8}
    hidden = made.items(lambda _: {"full_mask": None, "visible_fraction": 0.5})
    assert sample_of(hidden).instances == []
    assert len(sample_of(made.items(lambda _: {"visible_fraction": 0.1})).instances) == 16


def test_large_images_are_looked_at_in_small(made):
    wide = made[0].objects[0].mask.repeat(5, axis=1)

    def widen(view):
        item = replace(view.objects[0], mask=wide, full_mask=wide)
        return replace(view, rgb=None, depth=None, objects=[item])

    (first, *_) = sample_of(made.each(widen)).instances
    assert first.step == 3 and np.array_equal(first.small, wide[::3, ::3])


def test_views_that_cannot_be_read(made):
    views = [made[0], ValueError("a.png:\n damaged"), made[2]]
    sample = sample_of(Made(views))
    assert list(sample.views) == [0, 2] and sample.unreadable == ["a.png: damaged"]
    assert read_sample(made, [0], {}).without_model == {3, 8}


def test_neighbours(made):
    item = made[0].objects[0]
    twice = made.each(lambda view: replace(view, objects=(*view.objects, view.objects[0])))
    sample = sample_of(twice)
    first, other, second = sample.instances[:3]
    assert sample.neighbour(first, 1) is twice[1].objects[0]
    assert sample.neighbour(other, 1) is twice[1].objects[1]
    assert sample.neighbour(second, 1) is twice[1].objects[2]
    assert sample.neighbour(first, -1) is None
    lone = Made([made[0], replace(made[1], scene_id=2), replace(made[2], objects=(item,))])
    sample = sample_of(lone)
    assert sample.neighbour(sample.instances[0], 1) is None, "another scene"
    views = [made[0], replace(made[1], objects=(item,))]
    sample = sample_of(Made(views))
    assert sample.neighbour(sample.instances[1], 1) is None, "object 8 is not there"


def test_moments_are_of_the_hull_of_the_largest_part(made):
    mask = np.zeros((120, 160), bool)
    mask[10:31, 20:61] = True
    mask[15:25, 30:50] = False  # a hole
    mask[100:103, 100:103] = True  # something else
    (first, *_) = sample_of(made.items(lambda _: {"mask": mask, "full_mask": mask})).instances
    moments = first.moments
    assert moments["m00"] == 21 * 41
    assert moments["m10"] / moments["m00"] == 40 and moments["m01"] / moments["m00"] == 20
