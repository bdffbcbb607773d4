import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from data_tools.storage.records import decode_record, encode_record, to_json

DTYPES = ["?", "u1", "i1", "<u2", ">u2", "<i4", ">i8", "<u8", "<f2", "<f4", ">f4", "<f8", ">f8"]
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)  # fmt: skip
any_array = st.sampled_from(DTYPES).flatmap(
    lambda dtype: arrays.arrays(np.dtype(dtype), arrays.array_shapes(min_dims=0, min_side=0))
)


@given(record=st.dictionaries(st.text(), any_array | json_values, max_size=5))
def test_what_goes_in_comes_out(record):
    back = decode_record(encode_record(record))
    assert back.keys() == record.keys()
    for name, value in record.items():
        if not isinstance(value, np.ndarray):
            assert back[name] == value
            assert type(back[name]) is type(value)
            continue
        assert back[name].dtype == value.dtype.newbyteorder("=")
        assert back[name].shape == value.shape
        assert back[name].tobytes() == value.astype(back[name].dtype).tobytes(), "bit by bit"
        assert back[name].flags.writeable
        assert back[name].dtype.isnative


@given(array=any_array, number=st.integers())
def test_the_same_record_gives_the_same_bytes(array, number):
    data = encode_record({"a": array, "b": number, "c": {"x": 1, "y": 2}})
    swapped = array.astype(array.dtype.newbyteorder())
    assert encode_record({"c": {"y": 2, "x": 1}, "b": number, "a": swapped}) == data
    assert encode_record({"b": number, "a": np.asfortranarray(array).reshape(array.shape),
                          "c": {"x": 1, "y": 2}}) == data  # fmt: skip
    if array.ndim and array.size:
        wide = np.repeat(array, 2, axis=-1)
        assert encode_record({"a": wide[..., ::2], "b": number, "c": {"x": 1, "y": 2}}) == data


def test_a_record_by_hand():
    """The format as the module describes it, taken apart without its code."""
    import json
    import zlib

    record = {
        "z": np.array([[1, 3], [0, 7]], np.uint8),
        "flags": np.array([True, False, True]),
        "w": np.array([0x0102, 0x0304], ">u2"),
        "n": [1, None],
    }
    data = encode_record(record)
    length = int.from_bytes(data[:4], "little")
    head = json.loads(data[4 : 4 + length])
    assert head["values"] == {"n": [1, None]}
    assert [entry[:3] for entry in head["arrays"]] == [
        ["flags", "|b1", [3]], ["w", "<u2", [2]], ["z", "|u1", [2, 2]]
    ]  # fmt: skip
    bodies, position = [], 4 + length
    for *_, size in head["arrays"]:
        bodies.append(zlib.decompress(data[position : position + size]))
        position += size
    assert position == len(data)
    assert bodies == [b"\xa0", b"\x02\x04\x01\x03", b"\x01\x03\xff\x04"]


def test_smooth_images_and_masks_become_small():
    y, x = np.mgrid[:240, :320]
    rgb = np.stack([(x + y) // 4, y // 2, x // 3], axis=-1).astype(np.uint8)
    masks = np.stack([(x - 100) ** 2 + (y - 30 * i) ** 2 < 900 for i in range(5)])
    depth = (0.5 + 0.001 * x + 0.0003 * y).astype(np.float32)
    for array, share in ((rgb, 0.05), (masks, 0.01), (depth, 0.6)):
        assert len(encode_record({"a": array})) < share * array.nbytes


@pytest.mark.parametrize(
    ("record", "name"),
    [
        ({"a": np.array([1, "x"], object)}, "a: expected booleans"),
        ({"a": np.array(["x"])}, "a: expected booleans"),
        ({"a": np.array([1j])}, "a: expected booleans"),
        ({"a": np.array(["2020-01-01"], "M8[D]")}, "a: expected booleans"),
        ({"a": np.ma.masked_array([1, 2], [True, False])}, "a: expected what JSON holds"),
        ({"a": np.float32(1)}, "a: expected what JSON holds, got a float32"),
        ({"a": np.int64(1)}, "a: expected what JSON holds"),
        ({"a": {1, 2}}, "a: expected what JSON holds, got a set"),
        ({"a": b"x"}, "a: expected what JSON holds"),
        ({"a": float("nan")}, "a: expected a finite number"),
        ({"a": [1, {"b": float("inf")}]}, r"a\[1\]\['b'\]: expected a finite number"),
        ({"a": {1: 2}}, "a: expected strings for names, got 1"),
        ({"a": [np.zeros(2)]}, r"a\[0\]: expected what JSON holds, got a ndarray"),
        ({1: 2}, "record: expected strings"),
        ([1, 2], "record: expected a dict"),
        (None, "record: expected a dict, got a NoneType"),
    ],
)
def test_what_cannot_be_kept_is_refused(record, name):
    with pytest.raises(ValueError, match=name):
        encode_record(record)


@given(value=json_values)
def test_json_does_not_depend_on_the_order_of_names(value):
    def reversed_names(value):
        if isinstance(value, dict):
            return {key: reversed_names(value[key]) for key in reversed(value)}
        return [reversed_names(item) for item in value] if isinstance(value, list) else value

    assert to_json("value", value) == to_json("value", reversed_names(value))
    assert to_json("value", (1, (2,))) == "[1,[2]]"
