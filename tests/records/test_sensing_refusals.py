"""A malformed sensing file is refused with file, line, key and a way out."""

import json

import pytest

from tiswarm.base.errors import InputError
from tiswarm.records import io
from tiswarm.records.sensing_file import read_sensing_log

HEADER = {
    "format": "tiswarm-sensing",
    "version": 1,
    "dock_radius": 1.0,
    "dock_offsets": [[1.5, 0.0, 0.0], [-0.75, 1.3, 0.0], [-0.75, -1.3, 0.0]],
    "anchor_position": [0.0, 0.0, 1.0],
    "ground_z": 0.0,
    "length_unit": "R",
}
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
ANCHOR = {"robot": 10, "orientation_wxyz": UPRIGHT, "contacts": []}
JOINER = {"robot": 11, "orientation_wxyz": UPRIGHT, "contacts": [[0, 10, 1]]}
STANCE = {"orientation_wxyz": UPRIGHT, "pivot_dock": 0}


def header(**changes):
    """Give a whole file whose header is changed; a key set to ... is left out."""
    return [_changed(HEADER, changes), ANCHOR]


def noise(**changes):
    """Give a whole file that states noise."""
    return header(noise={"tilt_deg": 1.0, "yaw_deg": 2.0, **changes})


def joiner(**changes):
    """Give a whole file whose third line is changed; a key set to ... is left out."""
    return [HEADER, ANCHOR, _changed(JOINER, changes)]


def stance(**changes):
    """Give a whole file whose third line has a second stance that is changed."""
    return joiner(stances=[STANCE, _changed(STANCE, changes)])


def _changed(entries, changes):
    merged = {**entries, **changes}
    return {key: value for key, value in merged.items() if value is not ...}


NAN = float("nan")
REFUSED = [
    # the header
    (header(format=...), 1, "format", "is not a header; start it with"),
    (header(format="other"), 1, "format", "is not a header; start it with"),
    ([ANCHOR], 1, "format", "is not a header; start it with"),
    (header(version=4), 1, "version", "4 is not supported; this program reads versions 1, 2 and 3"),
    (header(version=True), 1, "version", "true is not supported"),
    (header(dock_radius=0), 1, "dock_radius", "0 should be greater than or equal to 0.000000001"),
    (header(dock_radius=1e-200), 1, "dock_radius", "1e-200 should be greater than or equal to"),
    (
        header(dock_radius=1e308),
        1,
        "dock_radius",
        "1e+308 should be less than or equal to 1000000000",
    ),
    (header(dock_radius="1"), 1, "dock_radius", '"1" should be a number'),
    (header(dock_radius=...), 1, "dock_radius", "is missing; add it"),
    (header(dock_radius=10**400), 1, "dock_radius", "should be a finite number"),
    (header(dock_offsets=[]), 1, "dock_offsets", "should have at least 1 item, not 0"),
    (
        header(dock_offsets=[[1, 2]]),
        1,
        "dock_offsets[0]",
        "should have at least 3 items, not 2",
    ),
    (header(dock_offsets=[[1, NAN, 0]]), 1, "dock_offsets[0][1]", "NaN should be a finite number"),
    (
        header(dock_offsets=[[0, 0, 0], [1e160, 0, 0]]),
        1,
        "dock_offsets[1]",
        "[1e+160, 0.0, 0.0] should be within 1000 R of 0.0, 1000 times dock_radius; correct one",
    ),
    (header(dock_offsets=[[0, 1001, 0]]), 1, "dock_offsets[0]", "[0.0, 1001.0, 0.0] should be"),
    (header(dock_offsets=[[1, 0, 0]] * 65), 1, "dock_offsets", "at most 64 items"),
    (header(anchor_position=[0, 0, 1e11]), 1, "anchor_position", "should be within 1e+10 R of 0.0"),
    (header(ground_z=-1e308), 1, "ground_z", "-1e+308 should be within 1e+10 R of 1.0"),
    (header(anchor_position=[0, 0, 0, 0]), 1, "anchor_position", "at most 3 items, not 4"),
    (header(anchor_position={}), 1, "anchor_position", "{} should be a list"),
    (header(ground_z="flat"), 1, "ground_z", '"flat" should be a number'),
    (header(version=...), 1, "version", "is missing; add it"),
    (
        header(version=..., dock_radius=..., anchor_position=...),
        1,
        "version, dock_radius, anchor_position",
        "are missing; add them",
    ),
    (header(length_unit=""), 1, "length_unit", "should have at least 1 character"),
    (header(length_unit="m,m"), 1, "length_unit", '"m,m" cannot be part of a column'),
    (header(length_unit='m"'), 1, "length_unit", "cannot be part of a column's name; write a name"),
    (header(length_unit="m\n"), 1, "length_unit", "cannot be part of a column's name"),
    (header(length_unit="\x1b[2J"), 1, "length_unit", "cannot be part of a column's name"),
    (header(length_unit=" m"), 1, "length_unit", "cannot be part of a column's name"),
    (header(length_unit="m" * 41), 1, "length_unit", "at most 40 characters"),
    (header(length_unit=3), 1, "length_unit", "3 should be text"),
    (header(noise={"tilt_deg": 1.0}), 1, "noise.yaw_deg", "is missing; add it"),
    (
        header(noise={"tilt_deg": -1, "yaw_deg": 0}),
        1,
        "noise.tilt_deg",
        "-1 should be greater than or equal to 0",
    ),
    (noise(yaw_deg=1e5), 1, "noise.yaw_deg", "100000.0 should be less than or equal to 180"),
    (noise(yaw_bias_deg=1e-300), 1, "noise.yaw_bias_deg", "1e-300 should be 0 or at least 1e-9"),
    (noise(spawn=1e308), 1, "noise.spawn", "1e+308 should be within 1e+10 R of 0.0"),
    (
        header(noise={"tilt_deg": 1, "yaw_deg": 0, "yaw": 0}),
        1,
        "noise.yaw",
        "unknown key; did you mean yaw_deg?",
    ),
    (header(ground=0.0), 1, "ground", "unknown key; did you mean ground_z?"),
    # a robot
    (joiner(robot="11"), 3, "robot", '"11" should be a whole number'),
    (joiner(robot=11.0), 3, "robot", "11.0 should be a whole number"),
    (joiner(robot=True), 3, "robot", "true should be a whole number"),
    (joiner(robot=2**63), 3, "robot", "9223372036854775808 should be less than or equal"),
    (joiner(robot=10), 3, "robot", "robot 10 has a line already; give every robot its own"),
    (joiner(orientation_wxyz=...), 3, "orientation_wxyz", "is missing; add it"),
    (
        joiner(orientation_wxyz=[1, 0, 0]),
        3,
        "orientation_wxyz",
        "should have at least 4 items",
    ),
    (joiner(orientation_wxyz=[0] * 4), 3, "orientation_wxyz", "has length 0; scale it to 1"),
    (joiner(orientation_wxyz=[1, 0.1, 0, 0]), 3, "orientation_wxyz", "length 1.00499; scale it"),
    (joiner(orientation_wxyz=[1e200] * 4), 3, "orientation_wxyz", "length 2e+200; scale it"),
    (joiner(orientation_wxyz=[NAN] * 4), 3, "orientation_wxyz[0]", "NaN should be a finite number"),
    (joiner(flip_height=float("inf")), 3, "flip_height", "Infinity should be a finite number"),
    (joiner(orientation_wxyz=[-1e308] * 4), 3, "orientation_wxyz", "length inf; scale it to 1"),
    (joiner(flip_height=1e12), 3, "flip_height", "1000000000000.0 should be within 1e+10 R of 1.0"),
    (joiner(spawn_position=[0, 1e15, 0]), 3, "spawn_position", "within 1e+10 R of [0.0, 0.0, 1.0]"),
    (joiner(flip_height="high"), 3, "flip_height", '"high" should be a number'),
    (
        joiner(spawn_position=[1, 2]),
        3,
        "spawn_position",
        "should have at least 3 items, not 2",
    ),
    (
        joiner(color="red"),
        3,
        "color",
        "unknown key; the keys here are robot, orientation_wxyz",
    ),
    (joiner(contact=[]), 3, "contact", "unknown key; did you mean contacts?"),
    # its contacts
    (joiner(contacts=...), 3, "contacts", "is missing; add it"),
    (joiner(contacts=[[0, 10]]), 3, "contacts[0]", "should have at least 3 items, not 2"),
    (joiner(contacts=[[0, 10, 1.5]]), 3, "contacts[0][2]", "1.5 should be a whole number"),
    (joiner(contacts=[[0, 10, 3]]), 3, "contacts[0]", "no dock 3; the header has docks 0 to 2"),
    (joiner(contacts=[[-1, 10, 0]]), 3, "contacts[0]", "no dock -1; the header has docks 0 to 2"),
    (
        joiner(contacts=[[0, 10, 1], [0, 99, 1]]),
        3,
        "contacts[1]",
        "robot 99 is not on an earlier line; list a contact at the later robot",
    ),
    (joiner(contacts=[[0, 11, 1]]), 3, "contacts[0]", "the robot touches itself; name another"),
    (
        joiner(contacts=[[0, 10, 1], [2, 10, 1], [0, 10, 1]]),
        3,
        "contacts[2]",
        "repeats contacts[0]; list it once",
    ),
    (
        [HEADER, {**ANCHOR, "contacts": [[0, 11, 0]]}, JOINER],
        2,
        "contacts[0]",
        "robot 11 is not on an earlier line; list a contact at the later robot",
    ),
    (
        [HEADER, ANCHOR, *({**JOINER, "robot": 100 + n} for n in range(25))],
        27,
        "contacts",
        "dock 1 of robot 10 has more than 24 contacts; delete false ones",
    ),
    # the ground
    (joiner(ground_docks=[0, 5]), 3, "ground_docks[1]", "no dock 5; the header has docks 0 to 2"),
    (joiner(ground_docks=[1, 1]), 3, "ground_docks[1]", "repeats ground_docks[0]; list it once"),
    (
        [{**HEADER, "ground_z": None}, {**ANCHOR, "ground_docks": [0]}],
        2,
        "ground_docks",
        "there is no ground; give ground_z in the header",
    ),
    # the stances
    (stance(pivot_dock=...), 3, "stances[1].pivot_dock", "is missing; add it"),
    (stance(pivot_dock=3), 3, "stances[1].pivot_dock", "no dock 3; the header has docks 0 to 2"),
    (stance(pivot=0), 3, "stances[1].pivot", "unknown key; did you mean pivot_dock?"),
    (stance(ground_docks=[9]), 3, "stances[1].ground_docks[0]", "no dock 9; the header has"),
    (stance(contacts=[[0, 12, 0]]), 3, "stances[1].contacts[0]", "robot 12 is not on an earlier"),
    (
        stance(orientation_wxyz=[0, 0, 0, 0]),
        3,
        "stances[1].orientation_wxyz",
        "has length 0; scale it to 1",
    ),
    ([HEADER], 2, "", "there are no robots; add a line for each, the anchor first"),
]


@pytest.mark.parametrize(("file", "line", "key", "problem"), REFUSED)
def test_a_malformed_line_is_refused_with_its_place(tmp_path, file, line, key, problem):
    """The message reads `file:line: key: what is wrong; what to do`."""
    path = tmp_path / "log.jsonl"
    path.write_text("".join(f"{json.dumps(entries)}\n" for entries in file))

    with pytest.raises(InputError) as refusal:
        read_sensing_log(path)

    assert str(refusal.value).startswith(": ".join(filter(None, [f"{path}:{line}", key, ""])))
    assert problem in str(refusal.value)
    assert "\n" not in str(refusal.value)


FIRST = json.dumps(HEADER).encode() + b"\n"
BROKEN = [
    (b"", 1, "the file is empty; start it with a header line"),
    (
        b"robot,x\n",
        1,
        "the first line is no JSON object; start a log with its header, or make a log",
    ),
    (b"{robot,x\n", 1, "not JSON at column 2: Expecting property name enclosed in double quotes;"),
    (b"[1, 2]\n", 1, "[1, 2] is not a JSON object; write the line as {...}"),
    (FIRST + b"\n", 2, "the line is empty; delete it"),
    (FIRST + json.dumps(ANCHOR).encode()[:-9], 2, "write one JSON object a line"),
    (FIRST + b'{"robot": 1, "robot": 2}', 2, "robot: the key stands twice in one object; keep one"),
    (FIRST + b"[" * 100_000, 2, "nested too deep, or a number of thousands of digits; write one"),
    (FIRST + b'{"robot": ' + b"9" * 5000 + b"}", 2, "a number of thousands of digits; write one"),
    (FIRST + b'{"robot": "\xff"}', 2, "byte 0xff is not UTF-8; save the file as UTF-8"),
    (FIRST + b'{"\\ud800": 1}', 2, "should be text"),
]


@pytest.mark.parametrize(("raw", "line", "problem"), BROKEN)
def test_bytes_that_are_not_json_are_refused_with_their_line(tmp_path, raw, line, problem):
    """The message names the file and the line."""
    path = tmp_path / "log.jsonl"
    path.write_bytes(raw)

    with pytest.raises(InputError) as refusal:
        read_sensing_log(path)

    assert str(refusal.value).startswith(f"{path}:{line}: ")
    assert problem in str(refusal.value)


def test_a_line_without_end_is_not_read_whole(tmp_path, monkeypatch):
    """The reader refuses a line beyond the limit before the line fills the memory."""
    monkeypatch.setattr(io, "MAX_LINE_BYTES", 1000)
    path = tmp_path / "log.jsonl"
    path.write_bytes(FIRST + b" " * 1001)

    with pytest.raises(InputError, match=r":2: the line is longer than .*; write one robot a line"):
        read_sensing_log(path)


@pytest.mark.parametrize(("name", "problem"), [("gone", "no such file; "), (".", "a folder; ")])
def test_a_file_that_cannot_be_opened_is_named(tmp_path, name, problem):
    """The message names the missing file or the folder, and what to do."""
    with pytest.raises(InputError, match=problem):
        read_sensing_log(tmp_path / name)
