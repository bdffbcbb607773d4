import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.storage.shards import DamagedShard, check_shard, pack_shard, read_bytes, read_index

KEY = "ab" * 32


@given(records=st.lists(st.binary(max_size=30), max_size=5), number=st.integers(0, 10**7))
def test_what_goes_in_comes_out(tmp_path_factory, records, number):
    path = tmp_path_factory.mktemp("shard") / "shard"
    path.write_bytes(pack_shard(KEY, number, records))
    check_shard(path, KEY, number)
    places = read_index(path, KEY, number)
    assert [read_bytes(path, place) for place in places] == records


@given(data=st.data())
def test_every_damage_is_found(tmp_path_factory, data):
    """One flipped bit anywhere, any cut, anything appended."""
    path = tmp_path_factory.mktemp("shard") / "000003.shard"
    whole = pack_shard(KEY, 3, [b"first record", b"", b"third"])
    kind = data.draw(st.sampled_from(["bit", "cut", "longer"]))
    position = data.draw(st.integers(0, len(whole) - 1))
    if kind == "bit":
        changed = bytearray(whole)
        changed[position] ^= 1 << data.draw(st.integers(0, 7))
    elif kind == "cut":
        changed = whole[:position]
    else:
        changed = whole + data.draw(st.binary(min_size=1, max_size=9))
    path.write_bytes(changed)
    with pytest.raises(DamagedShard, match=r"000003\.shard: "):
        check_shard(path, KEY, 3)


def test_every_bit_once(tmp_path):
    path = tmp_path / "shard"
    whole = pack_shard(KEY, 3, [b"first record", b"third"])
    for position in range(len(whole)):
        changed = bytearray(whole)
        changed[position] ^= 16
        path.write_bytes(changed)
        with pytest.raises(DamagedShard):
            check_shard(path, KEY, 3)


def test_the_reason_is_said(tmp_path):
    path = tmp_path / "shard"
    whole = pack_shard(KEY, 3, [b"first record", b"third"])
    for content, reason in (
        (b"", "empty file"),
        (whole[:7], "no shard: begins with b'POSESHR'"),
        (b"PK\3\4" + bytes(40), "no shard: begins with"),
        (whole[:40], "wrong checksum of the index"),
        (whole[:-1], f"expected {len(whole)} bytes, got {len(whole) - 1}"),
        (whole[:-1] + b"D", f"wrong checksum at byte {len(whole) - 5}"),
        (pack_shard("cd" * 32, 3, []), "a shard of another world, with the key cdcdcdcdcdcdcdcd"),
        (pack_shard(KEY, 4, []), "shard 4 in the place of shard 3"),
    ):
        path.write_bytes(content)
        with pytest.raises(DamagedShard, match=reason):
            check_shard(path, KEY, 3)
    path.unlink()
    with pytest.raises(FileNotFoundError):
        check_shard(path, KEY, 3)


def test_the_index_does_not_read_the_records(tmp_path):
    """Opening a world of gigabytes takes no longer than its indices."""
    path = tmp_path / "shard"
    whole = pack_shard(KEY, 0, [b"first", b"second"])
    path.write_bytes(whole[:-1] + b"!")
    first, second = read_index(path, KEY, 0)
    assert read_bytes(path, first) == b"first"
    assert second.checksum == zlib.crc32(b"second")
    with pytest.raises(DamagedShard, match="wrong checksum"):
        read_bytes(path, second)
