import json
import time

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from data_tools.linemod.folders import find_objects
from data_tools.linemod.poses import CAMERA, read_frames, read_text, read_yaml

finite = st.floats(allow_nan=False, allow_infinity=False)


def test_frames_in_every_layout(all_layouts):
    for made in all_layouts:
        for folder in find_objects(made.path).values():
            images = [12, 3, 0, 7] if folder.layout != "own" else [10, 0, 2]
            frames = read_frames(folder, images, "as_read")
            assert list(frames) == images
            for image, frame in frames.items():
                np.testing.assert_array_equal(frame.R, made.R[image])
                np.testing.assert_allclose(frame.t, made.t[image], rtol=1e-15)
                assert frame.depth_scale == 1
                assert (frame.box is None) == (folder.layout != "densefusion")
                assert (frame.K == CAMERA).all() == (folder.layout == "pvnet")


def test_poses_of_float32(pvnet):
    pose = np.column_stack([pvnet.R[0], pvnet.t[0]]).astype(np.float32)
    np.save(pvnet.path / "cat/pose/pose0.npy", pose)
    folder = find_objects(pvnet.path)[6]
    read = read_frames(folder, [0], "as_read")[0]
    np.testing.assert_array_equal(np.column_stack([read.R, read.t]), pose)
    assert read.R.dtype == read.t.dtype == np.float64
    projected = read_frames(folder, [0], "project")[0].R
    np.testing.assert_allclose(projected @ projected.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(projected, pose[:, :3], atol=1e-6)


@given(arrays.arrays(np.float64, st.tuples(st.integers(1, 5), st.just(3)), elements=finite))
def test_text_is_read_as_it_was_written(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("text") / "farthest.txt"
    np.savetxt(path, values, fmt="%.17g")
    np.testing.assert_array_equal(read_text(path, (-1, 3)), values)
    np.testing.assert_array_equal(read_text(path, (values.size,)), values.ravel())


entries = st.fixed_dictionaries(
    {"cam_R_m2c": st.lists(finite, min_size=9, max_size=9), "obj_id": st.integers()}
)


@settings(max_examples=20)
@given(
    st.dictionaries(st.integers(0, 10**9), st.lists(entries, max_size=3), min_size=1, max_size=3)
)
def test_yaml_is_read_as_it_was_written(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("yaml") / "gt.yml"
    path.write_text(yaml.safe_dump(content))
    assert read_yaml(path, list) == content
    # Python's own way to write numbers, such as 1e-05, which YAML 1.1 takes for a word.
    path.write_text("".join(f"{key}: {json.dumps(value)}\n" for key, value in content.items()))
    assert read_yaml(path, list) == content


@pytest.mark.parametrize("text", ["1e-05", "-1e5", "+2.E+7", "1.5e3", "12e0"])
def test_numbers_with_exponents(tmp_path, text):
    path = tmp_path / "info.yml"
    path.write_text(f"0: [{text}]\n")
    assert read_yaml(path, list) == {0: [float(text)]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty file"),
        ("3", "expected ids and what they stand for, got 3"),
        ("0: [1", "damaged YAML"),
        ("0: *there", "damaged YAML"),
        ("0: {a: 1, a: 2}", "damaged YAML: a key is there twice"),
        ("0: [1]\n00: [1]", "damaged YAML: a key is there twice"),
        ("0: 2002-13-45", "damaged YAML"),
        ("? [1, 2]\n: 3", "damaged YAML"),
        ("true: {}", "expected ids as keys, got True"),
        ("0.5: {}", "expected ids as keys, got 0.5"),
        ("0:", "0: expected a dict, got None"),
        ("4: []", r"4: expected a dict, got \[\]"),
        ("0: {}\n--- {}", "damaged YAML"),
        ("[" * 100000, "damaged YAML: nested more than 100 deep"),
        ("{0: [" + "{\n[" * 60, "damaged YAML: nested more than 100 deep"),
        ("- " * 100000 + "1", "damaged YAML: nested more than 100 deep"),
        ("? " * 100000 + "1", "damaged YAML: nested more than 100 deep"),
        ("\n".join(" " * i + "0:" for i in range(1500)), "damaged YAML: nested more than 100 deep"),
        ("\r".join(" " * i + "-" for i in range(1500)), "damaged YAML: nested more than 100 deep"),
    ],
)
def test_bad_yaml_is_refused(tmp_path, text, message):
    path = tmp_path / "info.yml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as refused:
        read_yaml(path, dict)
    assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty file"),
        (" \n", r"expected finite numbers, got \[\]"),
        ("1 2", r"expected numbers of shape \(-1, 3\)"),
        ("1 2 3\n4", r"expected numbers of shape \(-1, 3\)"),
        ("1 2 x", "expected numbers of shape .*'x'"),
        ("1 2 inf", "expected finite numbers"),
        ("1,2,3", "expected numbers of shape"),
    ],
)
def test_bad_text_is_refused(tmp_path, text, message):
    path = tmp_path / "farthest.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as refused:
        read_text(path, (-1, 3))
    assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_files_in_every_encoding(tmp_path, encoding):
    path = tmp_path / "camera.txt"
    path.write_bytes("600 0 7.5\r\n0 601.5 5.5\r\n0 0 1\r\n".encode(encoding))
    assert read_text(path, (3, 3)).tolist() == [[600, 0, 7.5], [0, 601.5, 5.5], [0, 0, 1]]
    path = tmp_path / "gt.yml"
    path.write_bytes("# Käse\n0: [1.5]\n".encode(encoding))
    assert read_yaml(path, list) == {0: [1.5]}


@pytest.mark.parametrize("word", ["1_000", "٣", "²", "1e", "0x10"])
def test_words_that_only_python_takes_for_numbers(tmp_path, word):
    path = tmp_path / "diameter.txt"
    path.write_text(word, encoding="utf-8")
    with pytest.raises(ValueError, match=r"diameter\.txt: expected numbers of shape"):
        read_text(path, (1,))


def test_aliases_are_read(tmp_path):
    """As PyYAML writes one list that stands in two places."""
    K = [600.0, 0, 7.5, 0, 601, 5.5, 0, 0, 1]
    content = {image: {"cam_K": K, "depth_scale": 1.0} for image in range(3)}
    path = tmp_path / "info.yml"
    path.write_text(yaml.safe_dump(content))
    assert "*id001" in path.read_text()
    assert read_yaml(path, dict) == content


def levels(first: str, each: str, count: int) -> str:
    lines = [f"0: &a0 {first}"]
    lines += [f"{i}: &a{i} {each.replace('*', f'*a{i - 1}')}" for i in range(1, count)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (levels("[1]", "[*, *, *, *, *, *, *, *, *, *]", 12), "more than 5000000 values"),
        (levels("{x: 1}", "{<<: [*, *, *, *, *, *, *, *]}", 12), "more than 5000000 values"),
        (levels("[1]", "[*]", 150), "nested more than 100 deep"),
        ("0: &a [*a]", "an alias stands within what it names"),
        ("0: &a {x: {y: *a}}", "an alias stands within what it names"),
        ("&a 0: [1]\n1: *b", "damaged YAML"),
    ],
)
def test_aliases_that_never_end(tmp_path, text, message):
    path = tmp_path / "gt.yml"
    path.write_text(text)
    began = time.perf_counter()
    with pytest.raises(ValueError, match=message) as refused:
        read_yaml(path, list)
    assert time.perf_counter() - began < 5
    assert str(refused.value).startswith(str(path)) and len(str(refused.value)) < 500


@pytest.mark.parametrize("number", ["0x" + "f" * 5000, "0b" + "1" * 40_000, "9" * 400])
def test_numbers_of_many_digits(tmp_path, number):
    path = tmp_path / "gt.yml"
    for text in (f"0: [{number}]", f"? {number}\n: []"):
        path.write_text(text)
        with pytest.raises(ValueError, match="hundreds of digits") as refused:
            read_yaml(path, list)
        assert str(refused.value).startswith(f"{path}: damaged YAML")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("value", [2**70, 10**18, -(2**63)])
def test_ids_beyond_64_bits(densefusion, value):
    densefusion.edit("data/01/gt.yml", "12:\n", f"{value}: []\n12:\n")
    folder = find_objects(densefusion.path)[1]
    if 0 < value < 2**63:
        assert list(read_frames(folder, [12], "as_read")) == [12]
        return
    with pytest.raises(ValueError, match=r"gt\.yml: expected ids as keys"):
        read_frames(folder, [12], "as_read")


def test_numbers_beyond_reason(densefusion, pvnet, own):
    """They are finite, but what is computed from them would not be."""

    def refused(made, message):
        for folder in find_objects(made.path).values():
            with pytest.raises(ValueError, match=message) as error:
                read_frames(folder, [0], "as_read")
            assert str(folder.path) in str(error.value)
            return

    own.edit("camera.txt", "7.5", "1e200")
    refused(own, "image 0: K: expected numbers of at most 1e\\+12")
    pvnet.t[0, 2] = 1e300
    pvnet.pose("cat/pose/pose0.npy", 0)
    refused(pvnet, "image 0: t: expected numbers of at most")
    densefusion.K[0][0] = 1e30
    densefusion.write("data/01/info.yml", yaml.safe_dump({0: {"cam_K": densefusion.K[0]}}))
    refused(densefusion, "image 0: K: expected numbers of at most")


def test_boxes_beyond_reason(densefusion):
    densefusion.edit("data/01/gt.yml", "- 12\n", "- 1.0e+40\n")
    with pytest.raises(ValueError, match="data/01: image 12: box: expected numbers of at most"):
        read_frames(find_objects(densefusion.path)[1], [12], "as_read")


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(ValueError, match=r"gt\.yml: no such file"):
        read_yaml(tmp_path / "gt.yml", list)
    with pytest.raises(ValueError, match=r"camera\.txt: no such file"):
        read_text(tmp_path / "camera.txt", (3, 3))
