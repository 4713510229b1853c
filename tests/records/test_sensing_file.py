"""A log survives its file, and a file that is read and written again keeps its bytes."""

import json
import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.records.mcap import SENSING, encode_messages
from tiswarm.records.sensing_file import log_entries, read_sensing_log, write_sensing_log
from tiswarm.records.sensing_format import line_schema
from tiswarm.records.sensing_log import (
    KEYS,
    LISTS,
    SensingLog,
    SensingNoise,
    Stances,
    canonical_contacts,
)

NEW_LISTS = [name for name, key in LISTS.items() if key.version == 2]

number = st.floats(-4.0, 4.0, allow_subnormal=False)  # within 1e10 of the smallest dock radii
place = st.tuples(number, number, number)
dock = st.integers(0, 2)
docks = st.sets(dock).map(sorted)
orientation = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda wxyz: np.linalg.norm(wxyz) > 0.1)
    .map(lambda wxyz: np.array(wxyz) / np.linalg.norm(wxyz))
)

spreads = st.just(0.0) | st.floats(1e-9, 4.0)
widths = st.floats(1e-5, 1e5)
letters = st.characters(codec="utf-8", exclude_categories=["C", "Z"], exclude_characters=',"')
fractions = st.floats(0.0, 1.0, allow_subnormal=False)
noises = st.builds(
    SensingNoise,
    tilt_deg=spreads,
    yaw_deg=spreads,
    yaw_bias_deg=st.none() | spreads,
    spawn=st.none() | spreads,
    missed_contacts=st.none() | fractions,
    wrong_docks=st.none() | fractions,
    false_contacts=st.none() | fractions,
    direction_deg=st.none() | spreads,
    connection_deg=st.none() | spreads,
)


def table(rows, dtype, width):
    """Rows, perhaps none, as an array of so many columns."""
    return np.array(list(rows), dtype=dtype).reshape(-1, width)


def sensed(earlier_robots):
    """Contacts of one robot at one stance: (own dock, other robot, other dock), sorted."""
    if earlier_robots == 0:
        return st.just([])
    rows = st.tuples(dock, st.integers(0, earlier_robots - 1), dock)
    return st.sets(rows, max_size=4).map(sorted)


@st.composite
def stances_of(draw, robots, radius, sources, *, ground):
    """Draw up to three earlier stances of every robot."""
    counts = [draw(st.integers(0, 3)) for _ in range(robots)]
    owner = np.repeat(np.arange(robots), counts).tolist()
    return Stances(
        start=np.cumsum([0, *counts]),
        orientation_wxyz=table([draw(orientation) for _ in owner], np.float64, 4),
        pivot_dock=np.array([draw(dock) for _ in owner], dtype=np.int32),
        contacts=table(
            [(row, *contact) for row, i in enumerate(owner) for contact in draw(sensed(i))],
            np.int32,
            4,
        ),
        ground_docks=table(
            [(row, a) for row in range(len(owner)) if ground for a in draw(docks)], np.int32, 2
        ),
        fixes=draw(fixes_of(len(owner), radius, sources)),
        ranges=draw(ranges_of(owner, radius, sources)),
        directions=draw(linked(owner, st.permutations([0.6, -0.8, 0.0]), 7)),
        connections=draw(linked(owner, orientation, 8)),
        touches=draw(touches_of(owner)),
        displacements=draw(displacements_of(owner, radius)),
    )


@st.composite
def fixes_of(draw, stances, radius, sources):
    """Draw up to two fixes, perhaps equal, in some stances, sorted."""
    rows = [
        row
        for stance in range(stances)
        for row in draw(repeated(st.tuples(
            st.just(stance), *[st.sampled_from([0.0, 0.6])] * 2, st.just(0.8),
            number, widths, st.integers(-1, sources - 1),
        )))
    ]  # fmt: skip
    rows = [(at, *unit(x, y, z), value, radius * sd, of) for at, x, y, z, value, sd, of in rows]
    return table(sorted(rows), np.float64, 7)


@st.composite
def ranges_of(draw, owner, radius, sources):
    """Draw up to two ranges, perhaps equal, in some stances of these robots, sorted."""
    rows = [
        row
        for stance, robot in enumerate(owner)
        if robot > 0
        for row in draw(repeated(st.tuples(
            st.just(stance), st.integers(0, robot - 1), widths, widths,
            st.integers(-1, sources - 1),
        )))
    ]  # fmt: skip
    rows = [(at, other, radius * far, radius * sd, of) for at, other, far, sd, of in rows]
    return table(sorted(rows), np.float64, 5)


@st.composite
def displacements_of(draw, owner, radius):
    """Draw up to two displacements, perhaps equal, in some stances of these robots, sorted."""
    rows = [
        row
        for stance, robot in enumerate(owner)
        if robot > 0
        for row in draw(repeated(st.tuples(
            st.just(stance), st.integers(0, robot - 1), widths, number, number, widths,
        )))
    ]  # fmt: skip
    rows = [(at, other, radius * x, y, z, radius * sd) for at, other, x, y, z, sd in rows]
    return table(sorted(rows), np.float64, 6)


def repeated(rows):
    """Draw no row, one, two, or one twice."""
    return st.lists(rows, max_size=2) | rows.map(lambda row: [row, row])


def unit(x, y, z):
    """Scale a direction to 1."""
    return np.array([x, y, z]) / np.linalg.norm([x, y, z])


@st.composite
def linked(draw, owner, measured, width):
    """Draw what some of these robots measure of a contact with an earlier one, by stance."""
    rows = [
        (stance, *draw(st.tuples(dock, st.integers(0, robot - 1), dock)), *draw(measured))
        for stance, robot in enumerate(owner)
        if robot > 0 and draw(st.booleans())
    ]
    return table(rows, np.float64, width)


@st.composite
def touches_of(draw, owner):
    """Draw a touch of an earlier robot in some stances of these robots, sorted by stance."""
    known = st.sampled_from([(-1, -1), (2, -1), (-1, 0)])
    pairs = [
        (stance, draw(st.integers(0, robot - 1)), draw(known))
        for stance, robot in enumerate(owner)
        if robot > 0 and draw(st.booleans())
    ]
    return table([(stance, own, other, its) for stance, other, (own, its) in pairs], np.int32, 4)


@st.composite
def logs(draw):
    """Draw any log that a file can hold."""
    robots = draw(st.integers(1, 5))
    names = st.lists(
        st.integers(-(2**63), 2**63 - 1), min_size=robots, max_size=robots, unique=True
    )
    ground_z = draw(st.none() | number)
    contacts = [(j, b, i, a) for i in range(robots) for a, j, b in draw(sensed(i))]
    unknown = (np.nan,) * 3
    radius = draw(st.floats(1e-9, 1e9))
    sources = draw(st.lists(st.text(letters, min_size=1, max_size=5), max_size=3, unique=True))
    measured = radius, len(sources)
    gone = sorted(draw(st.sets(st.integers(1, robots - 1)))) if robots > 1 else []
    stances = draw(st.none() | stances_of(robots, *measured, ground=ground_z is not None))
    walked = np.zeros(robots, np.bool_) if stances is None else np.diff(stances.start) > 0
    turns = [draw(orientation) for _ in range(robots)]
    for i in np.flatnonzero(~walked)[1:].tolist():
        turns[i] = draw(st.just(turns[i]) | st.just(np.full(4, np.nan)))
    return SensingLog(
        robot_id=np.array(draw(names), dtype=np.int64),
        dock_radius=radius,
        dock_offset_body=min(1.0, 100.0 * radius) * np.array([draw(place) for _ in range(3)]),
        anchor_position=np.array(draw(place)),
        orientation_wxyz=np.array(turns),
        contacts=table(contacts, np.int32, 4),
        ground_z=ground_z,
        ground_docks=table(
            [(i, a) for i in range(robots) if ground_z is not None for a in draw(docks)],
            np.int32,
            2,
        ),
        flip_height=np.array([draw(number | st.just(np.nan)) for _ in range(robots)]),
        spawn_position=np.array([draw(place | st.just(unknown)) for _ in range(robots)]),
        fixes=draw(fixes_of(robots, *measured)),
        ranges=draw(ranges_of(range(robots), *measured)),
        directions=draw(linked(range(robots), st.permutations([0.6, -0.8, 0.0]), 7)),
        connections=draw(linked(range(robots), orientation, 8)),
        touches=draw(touches_of(range(robots))),
        displacements=draw(displacements_of(range(robots), radius)),
        stances=stances,
        gone=np.array(gone, np.int64),
        left_after=np.array([draw(st.integers(robot + 1, robots)) for robot in gone], np.int64),
        noise=draw(st.none() | noises),
        source_name=tuple(sources),
        source_sd=radius * np.array([draw(widths) for _ in sources], np.float64),
        length_unit=draw(st.text(letters, min_size=1, max_size=5)),
    )


@pytest.mark.parametrize("kept", [2, 3, 4])
def test_a_log_that_was_cut_at_the_end_of_a_line_is_refused(tmp_path, kept):
    """A download that stopped there passed as a log of fewer robots, or of those that had left."""
    path = written(tmp_path / "a", {**HEADER, "version": 3}, ANCHOR, JOINER, {**JOINER, "robot": 4})
    log = replace(read_sensing_log(path), gone=np.array([1]), left_after=np.array([3]))
    write_sensing_log(log, path)
    lines = path.read_text().splitlines(keepends=True)
    assert json.loads(lines[0])["lines"] == len(lines) - 1 == 4
    path.write_text("".join(lines[:kept]))

    with pytest.raises(InputError) as refusal:
        read_sensing_log(path)

    expected = f"{path}:1: lines: 4 lines should follow, and {kept - 1} do; "
    assert str(refusal.value).startswith(expected)


def test_a_log_without_a_number_of_lines_is_read(tmp_path):
    """Robots that record do not know it yet, and programs of others do not write it."""
    log = read_sensing_log(written(tmp_path / "a", HEADER, ANCHOR, JOINER))

    assert log.robot_count == 2


def content(record):
    """Everything in a record, arrays as type, shape and bytes."""
    if is_dataclass(record):
        return {field.name: content(getattr(record, field.name)) for field in fields(record)}
    if isinstance(record, np.ndarray):
        return record.dtype.str, record.shape, record.tobytes()
    return repr(record)


HEADER = {
    "format": "tiswarm-sensing",
    "version": 2,
    "dock_radius": 1.0,
    "dock_offsets": [[1.5, 0.0, 0.0], [-0.75, 1.3, 0.0], [-0.75, -1.3, 0.0]],
    "anchor_position": [0.0, 0.0, 1.0],
    "ground_z": 0.0,
    "length_unit": "R",
    "noise": {"tilt_deg": 1.0, "yaw_deg": 2.0},
    "sources": {"radio": {"shared_sd": 0.3}, "north wall, tag 1": {"shared_sd": 0.05}},
}
STANCE = {
    "orientation_wxyz": [0.0, 1.0, 0.0, 0.0],
    "pivot_dock": 1,
    "contacts": [[0, 7, 2]],
    "ground_docks": [1],
    "fixes": [[0.6, 0.0, 0.8, 2.5, 0.1, "north wall, tag 1"]],
    "ranges": [[7, 4.5, 0.1]],
    "directions": [[0, 7, 2, 0.0, 0.6, 0.8]],
    "connections": [[0, 7, 2, 0.8, 0.0, 0.6, 0.0]],
    "touches": [[1, 7, None]],
    "displacements": [[7, -4.0, 0.5, 1.0, 0.1]],
}
ANCHOR = {"robot": 7, "orientation_wxyz": [1.0, 0.0, 0.0, 0.0], "contacts": []}
JOINER = {
    "robot": -3,
    "orientation_wxyz": [0.6, 0.0, 0.0, 0.8],
    "contacts": [[2, 7, 0], [0, 7, 1]],
    "ground_docks": [2],
    "fixes": [[0.0, 0.6, -0.8, 3.0, 0.5], [1.0, 0.0, 0.0, 9.0, 0.5]],
    "ranges": [[7, 9.0, 0.5], [7, 9.0, 0.5], [7, 9.0, 0.5, "radio"]],
    "directions": [[0, 7, 1, -1.0, 0.0, 0.0], [2, 7, 0, 0.0, 0.0, 1.0]],
    "connections": [[2, 7, 0, 0.6, 0.8, 0.0, 0.0]],
    "touches": [[None, 7, None], [None, 7, 2], [0, 7, None]],
    "displacements": [[7, -9.0, 0.0, 1.0, 0.5], [7, -9.0, 0.0, 1.0, 0.5]],
    "flip_height": 5.31,
    "spawn_position": [9.0, 0.0, 1.0],
    "stances": [STANCE],
}


PAGE = Path(__file__).parents[2] / "docs" / "files.md"
EXAMPLES = re.findall(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)


def written(path, *lines):
    """Write lines to a file, each an object."""
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return path


@settings(max_examples=25)
@given(log=logs())
def test_a_log_comes_back_bit_for_bit(scratch, log):
    """A file stores every array of a log; written again, the file keeps its bytes."""
    write_sensing_log(log, scratch)
    first = scratch.read_bytes()

    back = read_sensing_log(scratch)
    write_sensing_log(back, scratch)

    assert content(back) == content(log)
    assert scratch.read_bytes() == first


@pytest.mark.parametrize("line", [HEADER, ANCHOR, JOINER])
def test_the_schema_describes_each_line(line):
    """Other programs can check their lines by it."""
    jsonschema.validate(line, line_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**line, "flip_hight": 1.0}, line_schema())


def test_the_format_is_the_published_one(tmp_path):
    """The keys of header, robot and stance stand as documented, in that order."""
    path = tmp_path / "sensing.jsonl"
    write_sensing_log(read_sensing_log(written(path, HEADER, ANCHOR, JOINER)), path)

    header, anchor, joiner = map(json.loads, path.read_text().splitlines())

    stated = list(HEADER.items())
    assert list(header.items()) == [*stated[:2], ("lines", 2), *stated[2:]]
    assert anchor == {**ANCHOR, **{key: [] for key in ["ground_docks", *NEW_LISTS, "stances"]}}
    assert joiner == {**JOINER, "contacts": [[0, 7, 1], [2, 7, 0]]}
    assert list(joiner) == list(JOINER)
    assert list(joiner["stances"][0]) == list(STANCE)


def test_a_log_is_of_the_first_version_that_has_its_keys(tmp_path):
    """Programs that know version 1 alone read what they can."""
    path = tmp_path / "sensing.jsonl"
    joiner = {**JOINER, **{key: [] for key in NEW_LISTS}}
    joiner["stances"] = [{**STANCE, **dict.fromkeys(NEW_LISTS)}]
    header = {**HEADER, "sources": {}}

    write_sensing_log(read_sensing_log(written(path, header, ANCHOR, joiner)), path)

    header, *robots = path.read_text().splitlines()
    assert json.loads(header)["version"] == 1
    assert "sources" not in json.loads(header)
    assert not any(key in robot for robot in robots for key in NEW_LISTS)


@pytest.mark.parametrize(
    ("header", "orientation"),
    [
        (
            {**HEADER, "noise": {"tilt_deg": 1.0, "yaw_deg": 2.0, "direction_deg": 5.0}},
            [1, 0, 0, 0],
        ),
        (HEADER, None),
    ],
)
def test_new_noise_and_missing_compasses_make_version_2(tmp_path, header, orientation):
    """What version 1 cannot say is never written as version 1."""
    path = tmp_path / "sensing.jsonl"
    robot = {"robot": 8, "orientation_wxyz": orientation, "contacts": []}

    write_sensing_log(read_sensing_log(written(path, header, ANCHOR, robot)), path)

    header, _, joiner = map(json.loads, path.read_text().splitlines())
    assert header["version"] == 2
    assert joiner["orientation_wxyz"] == orientation


def test_sources_make_version_2(tmp_path):
    """A shared error is never lost, though no measurement has it yet."""
    path = tmp_path / "sensing.jsonl"

    write_sensing_log(read_sensing_log(written(path, HEADER, ANCHOR)), path)

    header, _ = map(json.loads, path.read_text().splitlines())
    assert header["version"] == 2
    assert header["sources"] == HEADER["sources"]


def test_mcap_messages_keep_sources(tmp_path):
    """A log that a robot recorded as messages has the sources of its file."""
    log = read_sensing_log(written(tmp_path / "log", HEADER, ANCHOR, JOINER))
    recorded = tmp_path / "log.mcap"

    recorded.write_bytes(encode_messages({SENSING: enumerate(log_entries(log))}))

    assert content(read_sensing_log(recorded)) == content(log)


def test_sources_are_columns_of_what_they_measured(tmp_path):
    """The log counts sources in the order of the header; -1 stands for none, as null does."""
    unnamed = {**ANCHOR, "fixes": [[0.0, 0.0, 1.0, 1.0, 0.5, None]]}

    log = read_sensing_log(written(tmp_path / "log", HEADER, unnamed, JOINER))

    assert log.source_name == ("radio", "north wall, tag 1")
    assert log.source_sd.tolist() == [0.3, 0.05]
    assert log.fixes[:, 6].tolist() == [-1.0, -1.0, -1.0]
    assert log.stances.fixes[:, 6].tolist() == [1.0]
    assert log.ranges[:, 4].tolist() == [-1.0, -1.0, 0.0]


def test_names_become_numbers_in_join_order(tmp_path):
    """Contacts name robots in the file and count them in the log."""
    log = read_sensing_log(written(tmp_path / "log", HEADER, ANCHOR, JOINER))

    assert log.robot_id.tolist() == [7, -3]
    assert log.contacts.tolist() == [[0, 1, 1, 0], [0, 0, 1, 2]]
    assert log.stances.contacts.tolist() == [[0, 0, 0, 2]]
    assert log.stances.start.tolist() == [0, 0, 1]


def test_a_missing_key_means_the_same_as_null(tmp_path):
    """Optional keys may be left out or null; their values are unknown."""
    header = {key: value for key, value in HEADER.items() if key not in {"noise", "sources"}}
    optional = dict.fromkeys(["ground_docks", "flip_height", "spawn_position", "stances"])
    without = read_sensing_log(written(tmp_path / "a", header, ANCHOR))

    nothing = {**header, "noise": None, "sources": None}
    null = read_sensing_log(written(tmp_path / "b", nothing, ANCHOR | optional))

    assert content(without) == content(null)
    assert without.stances is None
    assert without.noise is None
    assert without.source_name == ()
    assert np.isnan(without.flip_height).all()
    assert np.isnan(without.spawn_position).all()


def test_a_rounded_quaternion_is_scaled_to_one(tmp_path):
    """A quaternion of four decimals becomes a unit quaternion."""
    rounded = {**ANCHOR, "orientation_wxyz": [0.5774, 0.5774, 0.5774, 0.0]}

    log = read_sensing_log(written(tmp_path / "log", HEADER, rounded))

    np.testing.assert_allclose(np.linalg.norm(log.orientation_wxyz), 1.0, atol=1e-15)


def test_files_of_other_systems_are_read(tmp_path):
    """A byte order mark, Windows line ends and a missing last line end do not matter."""
    path = written(tmp_path / "log", HEADER, ANCHOR, JOINER)
    ours = read_sensing_log(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n").rstrip())

    theirs = read_sensing_log(path)

    assert content(theirs) == content(ours)


def test_a_number_that_is_not_finite_is_not_written(tmp_path):
    """A broken log leaves the old file as it was, and nothing beside it."""
    path = written(tmp_path / "log", HEADER, ANCHOR)
    log = read_sensing_log(path)
    before = path.read_bytes()
    log.anchor_position[0] = np.nan

    with pytest.raises(ValueError, match="JSON"):
        write_sensing_log(log, path)

    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path):
    """The message names the file and what to check."""
    log = read_sensing_log(written(tmp_path / "log", HEADER, ANCHOR))

    with pytest.raises(EnvironmentTroubleError, match=r"gone.log: cannot be written: .*; check"):
        write_sensing_log(log, tmp_path / "gone" / "log")


def test_rows_are_put_in_order_once():
    """Contacts sort by joiner, its dock, the other robot, its dock; repeated ones go."""
    rows = np.array([[1, 0, 2, 1], [0, 2, 2, 0], [0, 1, 1, 2], [0, 2, 2, 0]], dtype=np.int32)

    ordered = canonical_contacts(rows)

    assert ordered.tolist() == [[0, 1, 1, 2], [0, 2, 2, 0], [1, 0, 2, 1]]


@settings(max_examples=150)
@given(
    edits=st.lists(
        st.tuples(st.sampled_from("dif"), st.integers(0, 2000), st.binary(min_size=1, max_size=3)),
        min_size=1,
        max_size=4,
    )
)
def test_a_damaged_file_is_read_or_refused(scratch, edits):
    """Bytes deleted, inserted or flipped end in a log or an InputError, never otherwise."""
    header, events = {**HEADER, "version": 3}, [{"event": "leave", "robot": -3}]
    events.insert(0, {"event": "release", "robot": 7, "contacts": [[0, -3, 2]]})
    data = bytearray(written(scratch, header, ANCHOR, JOINER, *events).read_bytes())
    for kind, position, new in edits:
        at = position % len(data)
        data[at : at + (0 if kind == "i" else len(new))] = b"" if kind == "d" else new
    scratch.write_bytes(data)

    try:
        log = read_sensing_log(scratch)
    except InputError as error:
        assert str(error).startswith(f"{scratch}:")  # noqa: PT017 (either outcome is right)
    else:
        assert log.robot_count > 0


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_of_the_page_are_logs(tmp_path, example):
    """A reader who copies an example, after its header or ours, has a log."""
    path = tmp_path / "log"
    header = "" if '"format"' in example else f"{json.dumps(HEADER)}\n"
    path.write_text(header + example)

    assert read_sensing_log(path).robot_count == example.count('{"robot"')


@pytest.mark.parametrize("name", KEYS)
def test_each_key_is_on_the_page(name):
    """A reader of the page knows every key, the version that it needs, and its noise."""
    key = KEYS[name]
    page = PAGE.read_text()
    section = page.partition(f"### Version {key.version}\n")[2] if key.version > 1 else page

    assert f"\n| `{name}` | " in section.partition("\n### ")[0]
    assert not key.noise or f"`{key.noise}`" in page
