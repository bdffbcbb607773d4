from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.linemod.folders import (
    NAMES,
    Numbered,
    ObjectFolder,
    decode_text,
    find_objects,
    read_numbers_of,
    require_file,
)


def layout(root: Path, *folders: str) -> Path:
    root.mkdir()
    for folder in folders:
        (root / folder).mkdir(parents=True)
    return root


def test_the_thirteen_objects():
    assert sorted(NAMES) == [1, 2, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 15]
    assert (NAMES[6], NAMES[8], NAMES[15]) == ("cat", "driller", "phone")


def test_layouts_are_told_apart(tmp_path):
    pvnet = layout(tmp_path / "a", "duck/JPEGImages", "ape/JPEGImages", "fuse", "renders/ape")
    assert find_objects(pvnet) == {
        1: ObjectFolder(1, "ape", pvnet / "ape", "pvnet"),
        9: ObjectFolder(9, "duck", pvnet / "duck", "pvnet"),
    }
    odd = layout(tmp_path / "c", "data/10/rgb", "data/6/rgb")
    assert list(find_objects(odd)) == [6, 10], "in the order of the ids, not of the names"
    fusion = layout(
        tmp_path / "b", "data/06/rgb", "data/03/rgb", "models", "segnet_results/06_label"
    )
    for path in (fusion, fusion / "data", fusion / "data/06"):
        assert find_objects(path) == {
            6: ObjectFolder(6, "cat", fusion / "data/06", "densefusion"),
        }
    own = layout(tmp_path / "mug", "rgb", "mask", "pose")
    assert find_objects(own) == {1: ObjectFolder(1, "mug", own, "own")}
    (layout(tmp_path / "06", "rgb") / "camera.txt").touch()  # an own object with an odd name
    assert find_objects(tmp_path / "06")[1].layout == "own"


@pytest.mark.parametrize(
    "folders", [(), ("renders",), ("dog/JPEGImages",), ("data/03/rgb",), ("mug/rgb", "cup/rgb")]
)
def test_folders_that_hold_nothing(tmp_path, folders):
    with pytest.raises(ValueError, match="path: expected the folder of an object"):
        find_objects(layout(tmp_path / "x", *folders))


def test_folders_of_other_numbers(tmp_path):
    """Whoever continues DenseFusion's numbers is read; so are the bowl and the cup with poses."""
    more = layout(tmp_path / "more", *(f"data/{n}/rgb" for n in ("06", "16", "21", "100")))
    assert [(f.object_id, f.name, f.layout) for f in find_objects(more).values()] == [
        (6, "cat", "densefusion"),
        (16, "16", "densefusion"),
        (21, "21", "densefusion"),
        (100, "100", "densefusion"),
    ]
    assert list(find_objects(more / "data/16")) == [16]
    (layout(tmp_path / "cups", "data/07/rgb") / "data/07/gt.yml").touch()
    assert list(find_objects(tmp_path / "cups")) == [7]


def test_two_folders_of_one_object(tmp_path):
    twice = layout(tmp_path / "twice", "data/06/rgb", "data/6/rgb")
    with pytest.raises(ValueError, match="data: two folders of object 6, 06 and 6"):
        find_objects(twice)


@pytest.mark.parametrize("name", ["²", "٣", "9" * 19, "1" + "0" * 200])
def test_names_with_digits_that_are_no_numbers(tmp_path, name):
    """Of files they do not count, a folder is that of an own object; nothing breaks."""
    (tmp_path / f"{name}.png").touch()
    (tmp_path / "12.png").touch()
    assert Numbered(tmp_path).numbers == [12]
    own = layout(tmp_path / name, "rgb")
    assert find_objects(own) == {1: ObjectFolder(1, name, own, "own")}
    path = tmp_path / "train.txt"
    path.write_text(f"12\n{name}.png\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"train\.txt: no list of images: line 2"):
        read_numbers_of(path)


def test_suffixes_in_capitals_and_bmp(tmp_path):
    for name in ("0012.JPG", "13.bmp", "14.Png", "pose7.NPY"):
        (tmp_path / name).touch()
    assert Numbered(tmp_path).numbers == [12, 13, 14]
    assert Numbered(tmp_path, (".npy",)).numbers == [7]


ENDS = ["0012.JPG", "Käse/JPEGImages/000013.bmp", "14"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_lists_in_every_encoding(tmp_path, encoding):
    path = tmp_path / "train.txt"
    path.write_bytes("\r\n".join(ENDS).encode(encoding))
    assert read_numbers_of(path) == [12, 13, 14]
    for name in ("Käse", "mug"):
        assert decode_text(name.encode(encoding)) == name


def test_numbered_files(tmp_path):
    names = [
        "0012.png",
        "pose7.npy",
        "000003_label.png",
        "5.jpg",
        "cat.png",
        "5_depth.png",
        "1_2.png",
    ]
    for name in names:
        (tmp_path / name).touch()
    files = Numbered(tmp_path)
    assert files.numbers == [3, 5, 12]
    assert files[12] == tmp_path / "0012.png" and files[3] == tmp_path / "000003_label.png"
    assert Numbered(tmp_path, (".npy",)).numbers == [7]
    with pytest.raises(ValueError, match="no file of image 7"):
        files[7]


@given(
    lines=st.lists(
        st.tuples(
            st.integers(0, 10**6),
            st.sampled_from(["{}", "{:06d}.jpg", "{:04d}", "LINEMOD/cat/JPEGImages/{:06d}.jpg"]),
        ),
        min_size=1,
        unique_by=lambda line: line[0],
    ),
    end=st.sampled_from(["\n", "\r\n"]),
    last=st.booleans(),
)
def test_lists_keep_their_order(tmp_path_factory, lines, end, last):
    path = tmp_path_factory.mktemp("list") / "train.txt"
    text = end.join(form.format(number) for number, form in lines) + end * last
    path.write_bytes(text.encode())
    assert read_numbers_of(path) == [number for number, _ in lines]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n2\n01", "line 3: image 01 is on line 1 already"),
        ("a/1.jpg\nb/1.jpg", "line 2: image 1 is on line 1 already"),
        ("1 2", "line 1: expected an image, got '1 2'"),
        ("-1", "line 1: expected an image"),
        ("1.5", "line 1: expected an image"),
        ("cat/", "line 1: expected an image"),
        ("1\n\n2", "line 2: expected an image, got ''"),
        ("\n\n", "no images in this list"),
        ("", "empty file"),
        ("١", "no list of images"),
    ],
)
def test_bad_lists_are_refused(tmp_path, text, message):
    path = tmp_path / "train.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as refused:
        read_numbers_of(path)
    assert str(refused.value).startswith(str(path))


def test_files_that_are_not_there(tmp_path):
    for call in (require_file, read_numbers_of):
        with pytest.raises(ValueError, match=r"train\.txt: no such file"):
            call(tmp_path / "train.txt")
    with pytest.raises(ValueError, match="mask: no such folder"):
        Numbered(tmp_path / "mask")
    assert require_file(Path(__file__)) == Path(__file__)
