"""YAML as scenarios use it: 1.2 scalars, line marks, and no way to hurt the reader."""

import pytest

from tiswarm.base.errors import InputError
from tiswarm.scenario.yaml_source import parse_yaml, read_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("-.5", -0.5),
        ("3.", 3.0),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("+7", 7),
        ("1_000", "1_000"),
        ("12:30", "12:30"),
        ("2026-01-01", "2026-01-01"),
        ("0b1", "0b1"),
        ("no", "no"),
        ("on", "on"),
        ("TRUE", True),
        ("False", False),
        ("tRUE", "tRUE"),
        ("~", None),
        ("Null", None),
        (".inf", float("inf")),
        ("-.INF", float("-inf")),
        ("9" * 5000, float("inf")),
        ("'1'", "1"),
        ('"true"', "true"),
        ("=", "="),
        ("<<", "<<"),
    ],
)
def test_scalars_follow_yaml_1_2(text, value):
    """What is not a number, truth value or null of the core schema is text."""
    data = parse_yaml(f"[{text}]").data

    assert data == [value]
    assert type(data[0]) is type(value)


def test_keys_are_text():
    """A key means what it says, also where YAML 1.1 would see a number or a truth value."""
    assert parse_yaml("{on: 1, 10: 2, null: 3, 1e3: 4}").data == {
        "on": 1,
        "10": 2,
        "null": 3,
        "1e3": 4,
    }


def test_every_value_knows_its_place():
    """Keys and list entries are found by their way; what is missing, by what would hold it."""
    document = parse_yaml("a: 1\nb:\n  c:\n    - 1\n    -\n      d: 2\n")

    assert document.position_of(("a",)) == (1, 1, 4)
    assert document.position_of(("b",)) == (2, 1, 1)
    assert document.position_of(("b", "c")) == (3, 3, 3)
    assert document.position_of(("b", "c", 0)) == (4, 7, 7)
    assert document.position_of(("b", "c", 1)) == (6, 7, 7)
    assert document.position_of(("b", "c", 1, "d")) == (6, 7, 10)
    assert document.position_of(("b", "c", 1, "missing", "deeper")) == (6, 7, 7)
    assert document.position_of(("a", "missing")) == (1, 1, 1)
    assert document.position_of(("missing",)) == (1, 1, 1)


@pytest.mark.parametrize(
    ("raw", "problem"),
    [
        (b"", ":1: is empty; write a value, or a scenario"),
        (b"# only a comment\n", ":1: is empty; write"),
        (b"a: 1\nb: \xff\n", ":2: byte 0xff is not UTF-8; save the file as UTF-8"),
        (
            b"a: 1\nb: \x07\n",
            ":2: contains a character that is not allowed in text files; delete it",
        ),
        (b"a: 1\n\tb: 2\n", ":2: a tab cannot stand here; indent with spaces"),
        (b"a: 1\nb: 2\na: 3\n", ":3: a: the key stands on line 1 too; keep one"),
        (b"a:\n  b: 1\n  b: 2\n", ":3: a.b: the key stands on line 2 too; keep one"),
        (b"a: 1\n---\nb: 2\n", ":2: a second document starts here; keep one in a file"),
        (b"a: 1\nb: {c: 2\n", ":3: not YAML: expected ',' or '}', but got '<stream end>'; check"),
        (b"a: 1\n? [b]\n: 2\n", ":2: a key must be text; write `key: value`"),
        (b"a: &x 1\nb: *x\n", ":1: anchors and aliases such as x are not used here; write the"),
        (b"a: !!str 1\n", ":1: tags such as !!str are not used here; leave it out"),
        (b"a: !!python/name:os.system\n", ":1: tags such as !!str are not used here; leave it"),
        (b"a:\n " + b"[" * 100_000, ":2: nested deeper than 32 levels; is this a scenario?"),
        (b"- " * 100_000, ":1: nested deeper than 32 levels; is this a scenario?"),
        (b"- a\n" * 20_000, ":20000: more than 20000 values; is this a scenario?"),
        (b"a: 1\n" * 60_000, ": the file is larger than 256 KiB; is this a scenario?"),
        (b'a: "\\UFFFFFFFF"\n', ":1: not YAML: an escape is out of range; correct it"),
        (b'a: "\\ud800"\n', ":1: a: half a character (a lone surrogate); correct the escape"),
    ],
)
def test_what_a_scenario_cannot_be_is_refused(tmp_path, raw, problem):
    """The message is one line: file, line where there is one, what is wrong, what to do."""
    path = tmp_path / "scenario.yaml"
    path.write_bytes(raw)

    with pytest.raises(InputError) as refusal:
        read_yaml(path)

    assert str(refusal.value).startswith(f"{path}{problem}")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("name", "problem"), [("gone", "no such file; "), (".", "a folder; ")])
def test_a_file_that_cannot_be_opened_is_reported(tmp_path, name, problem):
    """A missing file and a folder are named, with what to do."""
    with pytest.raises(InputError, match=problem):
        read_yaml(tmp_path / name)
