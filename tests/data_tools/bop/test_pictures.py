import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_tools.bop.files import read_grey, read_mask, read_rgb
from data_tools.bop.pictures import MOST_PIXELS, decode_picture, is_jpeg, not_black

PATH = Path("folder/picture")
SMOOTH = np.full((16, 24, 3), (200, 100, 50), np.uint8)


def encode(pixels: np.ndarray, suffix: str = ".png", *options: int) -> bytes:
    return cv2.imencode(suffix, pixels, options)[1].tobytes()


def png(width: int, height: int, bits: int, kind: int, rows: bytes, *chunks: tuple) -> bytes:
    """A PNG from its raw rows, each beginning with 0; `kind` 0 grey, 3 palette."""
    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    parts = [(b"IHDR", header), *chunks, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n"
    for name, content in parts:
        data += struct.pack(">I", len(content)) + name + content
        data += struct.pack(">I", zlib.crc32(name + content))
    return data


PALETTE = (b"PLTE", bytes([0, 0, 0, 0, 128, 0, 0, 0, 255, 1, 0, 0]))


def test_palettes(tmp_path):
    """Labels with a palette: index 0 is black, every other one is an object."""
    path = tmp_path / "mask.png"
    path.write_bytes(png(4, 2, 8, 3, b"\0\0\1\2\3" + b"\0\3\0\0\1", PALETTE))
    np.testing.assert_array_equal(read_mask(path), [[0, 1, 1, 1], [1, 0, 0, 1]])
    np.testing.assert_array_equal(
        read_rgb(path)[0], [[0, 0, 0], [0, 128, 0], [0, 0, 255], [1, 0, 0]]
    )
    # The same with transparent entries: 0, which is black, and 1, which is not.
    transparent = (b"tRNS", bytes([0, 0, 255, 255]))
    path.write_bytes(png(4, 1, 8, 3, b"\0\0\1\2\3", PALETTE, transparent))
    np.testing.assert_array_equal(read_mask(path), [[0, 0, 1, 1]])
    # Two pixels in a byte, and eight.
    path.write_bytes(png(4, 1, 4, 3, b"\0\x01\x23", PALETTE))
    np.testing.assert_array_equal(read_mask(path), [[0, 1, 1, 1]])
    path.write_bytes(png(8, 1, 1, 0, b"\0\x65"))
    np.testing.assert_array_equal(read_mask(path), [[0, 1, 1, 0, 0, 1, 0, 1]])


def test_a_mask_in_a_lossy_file(tmp_path):
    """Black is not quite black any more; what is nearer to white than to black is the object."""
    wanted = np.zeros((64, 64), bool)
    wanted[16:41, 9:50] = True
    for colour in (255, (0, 255, 0), (255, 255, 255), 100):
        pixels = wanted[..., None] * np.uint8(np.atleast_1d(colour))
        path = tmp_path / "mask.jpg"
        path.write_bytes(encode(pixels, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 75))
        mask = read_mask(path)
        assert (mask != wanted).mean() < 0.02, colour
        assert not mask[:8].any() and mask[20:36, 14:44].all()
    path.write_bytes(encode(np.zeros((64, 64), np.uint8), ".jpg"))
    assert not read_mask(path).any()


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("tail", [b"", b"\0\0\r\n", b"made by a phone", bytes(range(256)) * 9])
def test_bytes_behind_the_end_of_a_jpeg(progressive, tail):
    pixels = np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8)
    options = (cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, 3)
    data = encode(pixels, ".jpg", *options)
    whole = decode_picture(PATH, data)
    np.testing.assert_array_equal(decode_picture(PATH, data + tail), whole)
    for length in range(2, len(data) - 1, 41):
        with pytest.raises(ValueError, match="folder/picture: JPEG without its end"):
            decode_picture(PATH, data[:length])


def test_the_end_of_a_thumbnail_is_not_that_of_the_picture():
    data, thumbnail = encode(SMOOTH, ".jpg"), encode(SMOOTH[:8, :8], ".jpg")
    exif = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    with_thumbnail = data[:2] + exif + data[2:]
    np.testing.assert_array_equal(
        decode_picture(PATH, with_thumbnail + b"more"), decode_picture(PATH, data)
    )
    with pytest.raises(ValueError, match="JPEG without its end"):
        decode_picture(PATH, with_thumbnail[:-40] + b"more")


def test_bmp():
    for pixels in (SMOOTH, SMOOTH[:, :5, 0]):
        data = encode(pixels, ".bmp")
        np.testing.assert_array_equal(decode_picture(PATH, data), pixels)
        for length in range(2, len(data)):
            with pytest.raises(ValueError, match="folder/picture: BMP cut off"):
                decode_picture(PATH, data[:length])


def huge(suffix: str, width: int, height: int) -> bytes:
    """A small picture whose header says that it is large."""
    if suffix == ".png":
        return png(width, height, 8, 0, b"")
    data = bytearray(encode(SMOOTH, suffix))
    if suffix == ".jpg":
        start = data.index(b"\xff\xc0")
        data[start + 5 : start + 9] = struct.pack(">HH", height, width)
    if suffix == ".bmp":
        data[18:26] = struct.pack("<II", width, height)
        data[30:34] = struct.pack("<I", 1)  # packed, so that its length says nothing
    if suffix == ".tif":
        table = struct.unpack_from("<I", data, 4)[0]
        for row in range(struct.unpack_from("<H", data, table)[0]):
            entry = table + 2 + 12 * row
            tag = struct.unpack_from("<H", data, entry)[0]
            if tag in (256, 257):
                value = width if tag == 256 else height
                struct.pack_into("<HHII", data, entry, tag, 4, 1, value)
    return bytes(data)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
def test_a_picture_is_refused_by_its_header(suffix, tmp_path):
    """Before any memory is taken: 30 000 x 30 000 pixels would be 10 GB in what followed."""
    path = tmp_path / "image"
    path.write_bytes(huge(suffix, 30_000, 30_000))
    for read in (read_rgb, read_grey, read_mask):
        with pytest.raises(ValueError, match="at most 100 million pixels, got 30000 x 30000"):
            read(path)


def test_the_limit_is_above_what_cameras_have():
    assert 7680 * 4320 * 3 <= MOST_PIXELS + 10**6
    wide = encode(np.zeros((10, 60_000), np.uint8))
    assert decode_picture(PATH, wide).shape == (10, 60_000)


def test_what_is_no_picture():
    for data in (b"GIF89a", b"\xff\xd8", b"II*\0", b"BM", b"BM" + bytes(60), b"\xff\xd8\xff\xd9"):
        with pytest.raises(ValueError, match="folder/picture: "):
            decode_picture(PATH, data)
    assert is_jpeg(encode(SMOOTH, ".jpg")) and not is_jpeg(encode(SMOOTH))


def test_not_black():
    image = np.zeros((1, 4, 4), np.uint8)
    image[0, 0] = (0, 3, 0, 255)
    image[0, 1] = (0, 0, 200, 0)  # transparent
    image[0, 2] = (0, 0, 0, 255)
    image[0, 3] = (200, 0, 0, 1)
    assert not_black(image, lossy=False).tolist() == [[True, False, False, True]]
    assert not_black(image, lossy=True).tolist() == [[False, False, False, True]]
