import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.bop.files import (
    find_image,
    read_bytes,
    read_depth,
    read_grey,
    read_integer,
    read_json,
    read_mask,
    read_number,
    read_numbers,
    read_rgb,
)

RGB = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
DEPTH = np.random.default_rng(1).integers(0, 65536, (5, 7), np.uint16)


def encode(pixels, suffix=".png", *parameters):
    stored = pixels[..., ::-1] if pixels.ndim == 3 and pixels.shape[2] == 3 else pixels
    return cv2.imencode(suffix, stored, parameters)[1].tobytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


def write(folder, data, name="image.png"):
    (folder / name).write_bytes(data)
    return folder / name


@given(seed=st.integers(0, 2**32), height=st.integers(1, 9), width=st.integers(1, 9))
def test_png_images_come_back_exactly(folder, seed, height, width):
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 256, (height, width, 3), np.uint8)
    depth = rng.integers(0, 65536, (height, width), np.uint16)
    grey = rng.integers(0, 256, (height, width), np.uint8)
    np.testing.assert_array_equal(read_rgb(write(folder, encode(rgb))), rgb)
    np.testing.assert_array_equal(read_grey(write(folder, encode(grey))), grey)
    np.testing.assert_array_equal(read_grey(write(folder, encode(depth))), depth)
    np.testing.assert_array_equal(read_mask(write(folder, encode(grey))), grey != 0)
    metres = read_depth(write(folder, encode(depth)), 0.1)
    assert metres.dtype == np.float32
    # The nearest float32 to the exact decimal number, up to the rounding of 0.1 in float64.
    np.testing.assert_array_equal(metres, np.float32(depth.astype(np.float64) * 0.1 / 1000))
    np.testing.assert_allclose(metres, depth / 10000, rtol=6e-8)


def test_tiff_and_jpeg(folder):
    np.testing.assert_array_equal(read_rgb(write(folder, encode(RGB, ".tif"), "a.tif")), RGB)
    np.testing.assert_array_equal(
        read_depth(write(folder, encode(DEPTH, ".tif"), "d.tif"), 1), np.float32(DEPTH / 1000)
    )
    smooth = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    jpeg = read_rgb(write(folder, encode(smooth, ".jpg"), "a.jpg"))
    assert np.abs(jpeg.astype(int) - smooth).max() <= 3  # red first, and JPEG's own loss


def test_png_is_refused_at_every_length(folder):
    for pixels, read in ((RGB, read_rgb), (DEPTH, lambda path: read_depth(path, 1))):
        whole = encode(pixels)
        for length in range(len(whole)):
            path = write(folder, whole[:length])
            with pytest.raises(ValueError, match=r"image\.png"):
                read(path)


def test_png_is_refused_with_any_byte_changed(folder):
    whole = encode(DEPTH)
    for position in range(len(whole)):
        damaged = bytearray(whole)
        damaged[position] ^= 0x10
        with pytest.raises(ValueError, match=r"image\.png"):
            read_depth(write(folder, bytes(damaged)), 1)


@given(data=st.data())
def test_real_sized_png_with_a_stretch_of_zeros_is_refused(folder, data):
    pixels = np.random.default_rng(2).integers(0, 256, (100, 200), np.uint8)
    whole = encode(pixels)
    start = data.draw(st.integers(0, len(whole) - 40))
    zeroed = whole[:start] + bytes(40) + whole[start + 40 :]
    assert zeroed != whole
    with pytest.raises(ValueError, match=r"image\.png"):
        read_grey(write(folder, zeroed))


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_cut_jpeg_and_tiff_are_refused(folder, suffix):
    whole = encode(np.tile(RGB, (8, 8, 1)), suffix)
    for length in range(0, len(whole) - 20, 7):
        with pytest.raises(ValueError, match="image"):
            read_rgb(write(folder, whole[:length], f"image{suffix}"))


BAD_IMAGES = [
    (b"", read_rgb, "empty file"),
    (b"GIF89a...", read_rgb, "neither PNG nor JPEG nor TIFF"),
    (b"version https://git-lfs.github.com/spec/v1\n", read_rgb, "neither PNG"),
    (bytes(500), read_depth, "neither PNG"),
    (encode(DEPTH), read_rgb, "expected three channels of 8 bits, got 1 of 16 bits"),
    (encode(RGB.astype(np.uint16)), read_rgb, "got 3 of 16 bits"),
    (encode(DEPTH.astype(np.uint8)), read_depth, "expected one channel of 16 bits, got 1 of 8"),
    (encode(RGB), read_depth, "expected one channel of 16 bits, got 3 of 8"),
    (encode(RGB), read_grey, "expected one channel"),
    (encode(np.dstack([RGB] * 2)[..., 2:]), read_grey, "expected one channel .* got 4 of 8"),
    (encode(DEPTH.astype(np.float32), ".tif"), read_mask, "expected 8 or 16 bits, got 1 of 32"),
    (encode(DEPTH.astype(np.float32), ".tif"), read_rgb, "three channels of 8 bits, got 1 of 32"),
]


@pytest.mark.parametrize(("data", "read", "message"), BAD_IMAGES)
def test_wrong_images_are_refused(folder, data, read, message):
    path = write(folder, data)
    with pytest.raises(ValueError, match=rf"image\.png: .*{message}"):
        read(path, 1) if read is read_depth else read(path)


def test_grey_and_rgba_are_colour_images(folder):
    grey = DEPTH.astype(np.uint8)
    for pixels in (grey, np.tile(grey[..., None], 3)):
        for suffix in (".png", ".tif", ".bmp"):
            path = write(folder, encode(pixels, suffix), f"grey{suffix}")
            np.testing.assert_array_equal(read_rgb(path), np.tile(grey[..., None], 3))
            np.testing.assert_array_equal(read_grey(path), grey)
    rgba = np.dstack([RGB[..., ::-1], grey])  # as OpenCV wants it, and transparent in places
    for suffix in (".png", ".tif"):
        path = write(folder, encode(rgba, suffix), f"rgba{suffix}")
        np.testing.assert_array_equal(read_rgb(path), RGB)


def test_a_suffix_in_capitals(folder):
    path = write(folder, b"", "000003.JPG")
    assert find_image(folder, "000003").samefile(path)


def test_find_image(folder):
    path = write(folder, b"", "000001.jpg")
    assert find_image(folder, "000001") == path
    with pytest.raises(FileNotFoundError, match="000002"):
        find_image(folder, "000002")


def test_read_bytes(folder):
    assert read_bytes(write(folder, b"abc", "some")) == b"abc"
    with pytest.raises(FileNotFoundError, match="nowhere: no such file"):
        read_bytes(folder / "nowhere")
    with pytest.raises(ValueError, match="cannot be read"):
        read_bytes(folder)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(content=st.dictionaries(st.text(), JSON, min_size=1, max_size=4), data=st.data())
def test_json_comes_back_and_is_refused_if_cut(folder, content, data):
    whole = json.dumps(content).encode()
    assert read_json(write(folder, whole, "a.json")) == content
    length = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(ValueError, match=r"a\.json"):
        read_json(write(folder, whole[:length], "a.json"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b'{"1": 1, "1": 2}', "'1' is there twice"),
        (b'{"1": NaN}', "NaN is no number"),
        (b'{"1": -Infinity}', "-Infinity is no number"),
        (b'{"1": 1}}', "Extra data"),
        (b'{"1": \xff}', "damaged JSON"),
        (b"[" * 100_000, "damaged JSON"),
        (bytes(20), "damaged JSON"),
        (b"", "empty file"),
    ],
)
def test_damaged_json_is_refused(folder, text, message):
    with pytest.raises(ValueError, match=rf"a\.json: .*{message}"):
        read_json(write(folder, text, "a.json"))


@given(values=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1))
def test_numbers_of_json_entries(values):
    entry = {"x": values, "first": values[0], "count": len(values)}
    assert read_numbers("file", entry, "x", len(values)).tolist() == values
    assert read_number("file", entry, "first") == values[0]
    assert read_integer("file", entry, "count") == len(values)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda: read_number("f: here", [], "x"), "f: here: expected a JSON object"),
        (lambda: read_number("f: here", {}, "x"), "f: here: x is missing"),
        (lambda: read_number("f: here", {"x": "1"}, "x"), "f: here: x: expected a finite number"),
        (lambda: read_number("f: here", {"x": True}, "x"), "expected a finite number, got True"),
        (lambda: read_number("f: here", {"x": None}, "x"), "expected a finite number, got None"),
        (lambda: read_number("f: here", {"x": 1e999}, "x"), "expected a finite number, got inf"),
        (lambda: read_number("f: here", {"x": 10**400}, "x"), "expected a finite number, got 1000"),
        (lambda: read_numbers("f: here", {"x": [1, 2]}, "x", 3), "expected 3 finite numbers"),
        (lambda: read_numbers("f: here", {"x": 1}, "x", 1), "expected 1 finite numbers, got 1"),
        (lambda: read_numbers("f: here", {"x": [1, [2]]}, "x", 2), "expected 2 finite numbers"),
        (lambda: read_integer("f: here", {"x": 1.0}, "x"), "expected an integer"),
        (lambda: read_integer("f: here", {"x": -1}, "x"), "expected an integer of at least 0"),
        (lambda: read_integer("f: here", {"x": True}, "x"), "expected an integer"),
    ],
)
def test_wrong_json_entries_are_refused(read, message):
    with pytest.raises(ValueError, match=message):
        read()


@given(
    st.sets(st.sampled_from([".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"])),
    st.integers(0, 10**7),
)
def test_an_image_is_found_by_its_number_alone(suffixes, number):
    with tempfile.TemporaryDirectory() as name:
        folder, stem = Path(name), f"{number:06d}"
        for suffix in suffixes:
            (folder / (stem + suffix)).touch()
        if suffixes - {".bmp"}:
            found = find_image(folder, stem)
            assert found.parent == folder
            assert found.stem == stem
            assert found.suffix in suffixes
        else:
            with pytest.raises(FileNotFoundError, match=stem):
                find_image(folder, stem)
