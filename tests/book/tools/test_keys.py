"""Keys of measured numbers: their text reads back, and nothing else does."""

import json

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from book.tools.keys import Key, select

words = st.text(max_size=12).filter(
    lambda word: word == word.strip() and not set(word) & set(";=") and len(word.splitlines()) < 2
)
keys = st.builds(Key, words.filter(bool), words, words, words)


def test_the_text_of_a_key():
    key = Key("pixel", "easy", "projection", "drill")
    assert str(key) == "method=pixel; split=easy; metric=projection; group=drill"
    assert str(Key("6d, chordal", metric="rotation < 10 deg")) == (
        "method=6d, chordal; metric=rotation < 10 deg"
    )
    assert str(Key("a")) == "method=a"


@given(keys)
def test_a_key_is_read_back_from_its_text(key):
    assert Key.parse(str(key)) == key and hash(Key.parse(str(key))) == hash(key)
    assert Key.parse(json.loads(json.dumps({str(key): 1.0})).popitem()[0]) == key


@given(keys, keys)
def test_other_keys_have_other_texts(one, other):
    assert (str(one) == str(other)) == (one == other)


@given(st.text(alphabet="amethodspliurcg=; \n", max_size=30))
@example("method=a; split=b")
def test_a_text_is_that_of_a_key_or_refused(text):
    try:
        key = Key.parse(text)
    except ValueError as error:
        assert str(error).startswith("text: expected text such as ")
    else:
        assert str(key) == text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "pixel",
        "split=easy",
        "method=",
        "method=a;",
        "method=a; ",
        "method=a;split=b",
        "method=a;  split=b",
        "method= a",
        "method=a; split=",
        "split=b; method=a",
        "method=a; method=a",
        "method=a; scale=b",
        "method=a=b",
        "method=a\n",
        None,
        3,
    ],
)
def test_texts_that_are_refused(text):
    with pytest.raises(ValueError, match="text: expected text such as .*, got "):
        Key.parse(text)


@pytest.mark.parametrize("field", ["method", "split", "metric", "group"])
@pytest.mark.parametrize("value", ["a;b", "a=b", " a", "a ", "a\nb", "\t", 3, None])
def test_fields_that_are_refused(field, value):
    with pytest.raises(ValueError) as caught:
        Key(**({"method": "m"} | {field: value}))
    kind = "one line without" if isinstance(value, str) else "a string"
    assert str(caught.value).startswith(f"{field}: expected {kind}")
    assert str(caught.value).endswith(f"got {value!r}")


def test_a_key_names_a_method():
    with pytest.raises(ValueError, match="method: expected a name, got ''"):
        Key("", "easy")


def test_keys_cannot_be_changed_and_have_an_order():
    with pytest.raises(AttributeError):
        Key("a").split = "b"
    assert sorted([Key("b"), Key("a", "y"), Key("a", "x", "z")])[0] == Key("a", "x", "z")


def test_selecting():
    values = {
        Key(method, split, "add", group): (method, split, group)
        for method in "ab"
        for split in ("easy", "occluded")
        for group in ("", "drill")
    }
    assert select(values) == values
    easy = select(values, split="easy", metric="add", group="")
    assert list(easy.values()) == [("a", "easy", ""), ("b", "easy", "")]
    assert list(select(values, method="b", group="drill")) == [
        Key("b", "easy", "add", "drill"),
        Key("b", "occluded", "add", "drill"),
    ]
    assert select(values, split="") == select(values, metric="projection") == {}
    with pytest.raises(TypeError):
        select(values, object="drill")
