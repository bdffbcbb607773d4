import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import data_tools
from data_tools import Dataset, ObjectView, View, readers

K = np.array([[500.0, 0, 4], [0, 500, 3], [0, 0, 1]])
EYE = np.eye(3)


def item(**changes):
    return ObjectView(**({"object_id": 1, "R": EYE, "t": [0, 0, 1]} | changes))


def view(**changes):
    return View(**({"K": K, "scene_id": 1, "image_id": 2} | changes))


@given(seed=st.integers(0, 2**32), height=st.integers(1, 6), width=st.integers(1, 6))
def test_a_full_record(seed, height, width):
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width)) < 0.5
    symmetries = np.tile(np.eye(4), (3, 1, 1))
    coordinates = rng.random((height, width, 3), np.float32) * mask[..., None]
    known = item(
        category="mug",
        box=[1, 2, 3, 4],
        mask=mask,
        full_mask=~mask,
        visible_fraction=0.25,
        size=[0.1, 0.2, 0.3],
        symmetries=symmetries,
        coordinates=coordinates,
    )
    rgb = rng.integers(0, 256, (height, width, 3), np.uint8)
    depth = rng.random((height, width), np.float32)
    full = view(
        rgb=rgb,
        ir=rgb[..., 0],
        depth=depth,
        T_world_cam=np.eye(4),
        group=("left", 7),
        objects=[known, item()],
    )
    assert full.shape == (height, width)
    assert full.rgb is rgb, "images are not copied"
    assert full.depth is depth
    assert full.group == ("left", 7)
    assert isinstance(full.objects, tuple)
    for array in (full.K, full.T_world_cam, known.R, known.t, known.box, known.size):
        assert array.dtype == np.float64
    assert known.box.tolist() == [1, 2, 3, 4]
    assert known.mask is mask
    assert known.coordinates is coordinates
    size = f"{width} x {height}"
    assert repr(full) == f"View(scene 1, image 2: {size} rgb+ir+depth, objects [1, 1])"
    assert repr(known) == "ObjectView(1 mug at [0.0, 0.0, 1.0] m, 25% visible)"


def test_an_empty_record():
    bare = view()
    assert bare.shape is None
    assert bare.group == (1, 2)
    assert repr(bare) == "View(scene 1, image 2: no image, objects [])"
    assert repr(item()) == "ObjectView(1 at [0.0, 0.0, 1.0] m)"
    assert view(objects=[item(mask=np.ones((2, 3), bool))]).shape == (2, 3)
    assert item().coordinates is None
    assert view(objects=[item(coordinates=XYZ)]).shape == (2, 3)


def test_records_are_frozen():
    with pytest.raises(AttributeError):
        view().scene_id = 3
    with pytest.raises(AttributeError):
        item().t = np.zeros(3)


NAN = np.full((3, 3), np.nan)
RGB = np.zeros((2, 3, 3), np.uint8)
XYZ = np.ones((2, 3, 3), np.float32)
MASK = np.ones((2, 3), bool)
BAD = [
    (lambda: item(object_id=-1), "object_id"),
    (lambda: item(object_id=1.0), "object_id"),
    (lambda: item(object_id=True), "object_id"),
    (lambda: item(R=np.eye(4)), "R"),
    (lambda: item(R=NAN), "R"),
    (lambda: item(R=[[1, 0], [0]]), "R"),
    (lambda: item(R="eye"), "R"),
    (lambda: item(R=EYE > 0), "R"),
    (lambda: item(t=[[0, 0, 1]]), "t"),
    (lambda: item(t=[0, 0, np.inf]), "t"),
    (lambda: item(category=5), "category"),
    (lambda: item(box=[1, 2, 3]), "box"),
    (lambda: item(box=[1, 2, -3, 4]), "box"),
    (lambda: item(mask=np.zeros((2, 3))), "mask"),
    (lambda: item(mask=np.zeros((2, 3), np.uint8)), "mask"),
    (lambda: item(mask=np.zeros((2, 3, 1), bool)), "mask"),
    (lambda: item(full_mask=np.zeros((0, 3), bool)), "full_mask"),
    (lambda: item(visible_fraction=1.5), "visible_fraction"),
    (lambda: item(visible_fraction=float("nan")), "visible_fraction"),
    (lambda: item(size=[1, 2, -1]), "size"),
    (lambda: item(symmetries=np.eye(4)), "symmetries"),
    (lambda: item(symmetries=np.zeros((0, 4, 4))), "symmetries"),
    (lambda: item(symmetries=2 * np.eye(4)[None]), "symmetries"),
    (lambda: item(coordinates=XYZ.astype(float)), "coordinates"),
    (lambda: item(coordinates=XYZ[..., :2]), "coordinates"),
    (lambda: item(coordinates=XYZ[0]), "coordinates"),
    (lambda: item(coordinates="all"), "coordinates"),
    (lambda: item(coordinates=np.float32(np.inf) * XYZ), "coordinates: expected finite"),
    (lambda: item(coordinates=XYZ, mask=MASK.T), "coordinates: .* as in the mask"),
    (lambda: item(coordinates=XYZ, mask=~MASK), "coordinates: expected 0 outside the mask"),
    (lambda: view(rgb=RGB[:1], objects=[item(coordinates=XYZ)]), r"objects\[0\]\.coordinates"),
    (lambda: view(scene_id=-1), "scene_id"),
    (lambda: view(image_id="3"), "image_id"),
    (lambda: view(K=np.eye(4)), "K"),
    (lambda: view(K=np.diag([1.0, -1, 1])), "K"),
    (lambda: view(K=np.diag([1.0, 1, 2])), "K"),
    (lambda: view(K=K.T), "K"),
    (lambda: view(rgb=RGB.astype(float)), "rgb"),
    (lambda: view(rgb=RGB[..., 0]), "rgb"),
    (lambda: view(rgb=np.zeros((2, 3, 4), np.uint8)), "rgb"),
    (lambda: view(ir=RGB), "ir"),
    (lambda: view(depth=np.zeros((2, 3))), "depth"),
    (lambda: view(depth=np.full((2, 3), -1, np.float32)), "depth"),
    (lambda: view(K=np.diag([1e200, 1, 1])), r"K: expected values of at most 1e\+12"),
    (lambda: item(t=[0, 0, 1e300]), r"t: expected values of at most 1e\+12"),
    (lambda: item(box=[0, 0, 1e39, 1]), r"box: expected values of at most 1e\+12"),
    (lambda: view(depth=np.full((2, 3), np.nan, np.float32)), "depth"),
    (lambda: view(T_world_cam=EYE), "T_world_cam"),
    (lambda: view(T_world_cam=np.ones((4, 4))), "T_world_cam"),
    (lambda: view(group=[1]), "group"),
    (lambda: view(objects=[5]), "objects"),
    (lambda: view(rgb=RGB, depth=np.zeros((3, 2), np.float32)), "depth"),
    (
        lambda: view(rgb=RGB, objects=[item(), item(mask=np.zeros((3, 2), bool))]),
        r"objects\[1\]\.mask",
    ),
    (lambda: data_tools.open(5), "source"),
    (lambda: data_tools.open("nocs_:PATH"), "source: expected .* one of bop, .*, got 'nocs_:PATH'"),
    (lambda: data_tools.open(""), "source"),
    (lambda: data_tools.open("bop"), "path"),
    (lambda: data_tools.open("bop:"), "path: expected a folder after the colon, got 'bop:'"),
    (lambda: data_tools.open("bop:/nowhere"), "path"),
]


@pytest.mark.parametrize(("call", "argument"), BAD)
def test_bad_input_is_refused(call, argument):
    with pytest.raises(ValueError, match=f"^{argument}"):
        call()


class Numbers(Dataset):
    """A data set of three views, as small as one can be."""

    object_ids = ()

    def __init__(self, path, split, step=1):
        self.path, self.split, self.step = path, split, step

    def __len__(self):
        return 3

    def __getitem__(self, index):
        return view(image_id=index * self.step)

    def models(self):
        raise ValueError("no models")


def test_a_data_set_is_iterated_as_often_as_asked_for():
    numbers = Numbers(None, None)
    for _ in range(2):
        assert [v.image_id for v in numbers] == [0, 1, 2]
    with pytest.raises(TypeError):
        Dataset()


@given(path=st.none() | st.text(min_size=1), split=st.none() | st.text(), step=st.integers(1, 9))
def test_open_hands_on_what_it_is_given(path, split, step):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(readers.READERS, "numbers", f"{__name__}:Numbers")
        patch.setitem(sys.modules, __name__, sys.modules[Numbers.__module__])
        source = "numbers" if path is None else f"numbers:{path}"
        dataset = data_tools.open(source, split=split, step=step)
    assert (dataset.path, dataset.split, dataset.step) == (path, split, step)


def test_the_package_is_imported_at_once():
    """Without a reader, and without torch: `python -c "import data_tools"` answers immediately."""
    code = "import sys, data_tools; print(dir(data_tools)); print('torch' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines() == [
        "['Dataset', 'ModelSet', 'ObjectView', 'View', 'open']",
        "False",
    ]
    with pytest.raises(AttributeError, match="nothing"):
        data_tools.nothing  # noqa: B018
