"""Keys of measured numbers: what was measured, on which split, by which metric, of which group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TypeVar

from posecore.arrays import fail

__all__ = ["Key", "select"]

T = TypeVar("T")


@dataclass(frozen=True, order=True)
class Key:
    """What a measured number is a number of. Its text is one line that reads back as the key:

        str(Key("pixel", "easy", "add", "drill"))
        # "method=pixel; split=easy; metric=add; group=drill"

    Fields that are empty are left out.

    The chapters write metrics alike: "add" is the recall in % by ADD(-S) below a tenth of the
    diameter, "projection" that by the 2D projection metric; "rotation" the mean error in degrees,
    "rotation median", "rotation largest", "rotation percentile 90" and "rotation < 10 deg", a share
    in %, are others of the same errors; "time" is in ms.

    Args:
        method: the method, network or loss; "6d, chordal" where two choices are crossed.
        split: what it was tested on; empty if there is but one, or over all of them.
        metric: by what it was judged.
        group: of which part: an object, a bin of visibility, an image size; empty for all.

    Raises:
        ValueError: if the method is empty, or a field is no string, has ";", "=" or a line break in
            it, or blanks at an end.
    """

    method: str
    split: str = ""
    metric: str = ""
    group: str = ""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not isinstance(value, str):
                fail(name, "a string", repr(value))
            if value != value.strip() or len(value.splitlines()) > 1 or set(value) & set(";="):
                fail(name, 'one line without ";", "=" and blanks at its ends', repr(value))
        if not self.method:
            fail("method", "a name", repr(self.method))

    def __str__(self) -> str:
        return "; ".join(f"{name}={value}" for name, value in asdict(self).items() if value)

    @classmethod
    def parse(cls, text: str) -> Key:
        """The key of a text that `str` made.

        Raises:
            ValueError: for any other text, also one with the fields in another order.
        """
        expected = 'text such as "method=pixel; split=easy", fields in their order'
        if not isinstance(text, str):
            fail("text", expected, repr(text))
        parts = [part.partition("=")[::2] for part in text.split("; ")]
        try:
            key = cls(**dict(parts))
        except (TypeError, ValueError):
            fail("text", expected, repr(text))
        if str(key) != text:
            fail("text", expected, repr(text))
        return key


def select(
    values: Mapping[Key, T],
    *,
    method: str | None = None,
    split: str | None = None,
    metric: str | None = None,
    group: str | None = None,
) -> dict[Key, T]:
    """What belongs to keys with these fields, in the order of `values`.

    Args:
        values: anything by key.
        method, split, metric, group: what the field must be. Not given, it may be anything; ""
            asks for keys without it.
    """
    wanted = {"method": method, "split": split, "metric": metric, "group": group}
    wanted = {name: value for name, value in wanted.items() if value is not None}
    return {key: value for key, value in values.items() if wanted.items() <= asdict(key).items()}
