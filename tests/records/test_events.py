"""Events say what changed after robots joined; the log is that of the swarm after all of them."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.records.test_sensing_file import ANCHOR, HEADER, JOINER, content, written
from tiswarm.base.errors import InputError
from tiswarm.records.sensing_file import log_entries, read_sensing_log, write_sensing_log
from tiswarm.records.sensing_format import (
    line_schema,
    parse_header,
    parse_line,
    parse_robot,
)
from tiswarm.records.sensing_log import LISTS

OF_DOCKS = [name for name, key in LISTS.items() if key.is_of_docks]

HEADER = {**HEADER, "version": 3}
THIRD = {
    "robot": 5,
    "orientation_wxyz": [1.0, 0.0, 0.0, 0.0],
    "contacts": [[0, 7, 1], [1, -3, 2]],
    "ranges": [[-3, 4.0, 0.1]],
    "directions": [[1, -3, 2, 1.0, 0.0, 0.0]],
    "touches": [[None, -3, 0]],
}
LEAVE = {"event": "leave", "robot": -3}
RELEASE = {"event": "release", "robot": 5, "contacts": [[1, -3, 2]]}
REPLACE = {"event": "replace", **THIRD, "contacts": [[0, 7, 1]]}

dock = st.integers(0, 2)
turns = st.sampled_from([[1.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.0, 0.8]])


@st.composite
def sensed(draw, earlier):
    """Draw the lists of a stance that touches some of these robots."""
    docks = st.tuples(dock, st.sampled_from(earlier), dock) if earlier else st.nothing()
    several = st.lists(docks, max_size=3, unique=True) if earlier else st.just([])
    unknown = [[None, other, its] for _, other, its in draw(several)]
    return {
        "contacts": [[*row] for row in draw(several)],
        "directions": [[*row, 0.0, 1.0, 0.0] for row in draw(several)],
        "connections": [[*row, 1.0, 0.0, 0.0, 0.0] for row in draw(several)],
        "touches": [row for place, row in enumerate(unknown) if row not in unknown[:place]],
        "ranges": [[other, 3.0, 0.1] for _, other, _ in draw(several)],
        "ground_docks": draw(st.sets(dock).map(sorted)),
    }


@st.composite
def robots(draw, name, earlier):
    """Draw the line of a robot of this name, after some others."""
    line = {"robot": name, "orientation_wxyz": draw(turns), **draw(sensed(earlier))}
    if draw(st.booleans()):
        line["flip_height"] = draw(st.floats(0.0, 9.0))
    if draw(st.booleans()):
        line["stances"] = [
            {"orientation_wxyz": draw(turns), "pivot_dock": draw(dock), **draw(sensed(earlier))}
            for _ in range(draw(st.integers(0, 2)))
        ]
    return line


@st.composite
def histories(draw):
    """Draw lines with events, the lines of robots after all of them, and who has left."""
    names = draw(st.lists(st.integers(-9, 9), min_size=2, max_size=5, unique=True))
    lines, robot_of, gone = [], {}, set()
    for name in names[:2]:
        robot_of[name] = draw(robots(name, [*robot_of]))
        lines.append(robot_of[name])
    for _ in range(draw(st.integers(1, 8))):
        present = [name for name in robot_of if name not in gone]
        kind = draw(st.sampled_from(["join", "leave", "release", "replace"]))
        held = [
            (name, *item[:3])
            for name in present
            for key in OF_DOCKS
            for item in robot_of[name][key]
            if item[1] not in gone
        ]
        if kind == "join" and len(robot_of) < len(names):
            name = names[len(robot_of)]
            robot_of[name] = draw(robots(name, [*robot_of]))
            lines.append(robot_of[name])
        elif kind == "leave" and present[1:]:
            name = draw(st.sampled_from(present[1:]))
            gone.add(name)
            lines.append({"event": "leave", "robot": name})
        elif kind == "replace":
            name = draw(st.sampled_from(present))
            robot_of[name] = draw(robots(name, [*robot_of][: [*robot_of].index(name)]))
            lines.append({"event": "replace", **robot_of[name]})
        elif kind == "release" and held:
            name, own, other, its = draw(st.sampled_from(held))
            line = robot_of[name]
            robot_of[name] = line | {
                key: [item for item in line[key] if item[:3] != [own, other, its]]
                for key in OF_DOCKS
            }
            ends = (name, [own, other, its]) if draw(st.booleans()) else (other, [its, name, own])
            lines.append({"event": "release", "robot": ends[0], "contacts": [ends[1]]})
    return lines, [*robot_of.values()], gone


@settings(max_examples=60)
@given(history=histories())
def test_a_log_with_events_is_that_of_its_lines_after_them(scratch, history):
    """Who writes the lines as they are at the end, and who left after each, has the same log."""
    lines, at_end, gone = history
    joined, after = 0, {}
    for line in lines:
        joined += "event" not in line
        if line.get("event") == "leave":
            after.setdefault(joined, []).append(line)
    final = [
        each
        for count, line in enumerate(at_end, 1)
        for each in (line, *sorted(after.get(count, []), key=lambda leave: at_end.index(
            next(line for line in at_end if line["robot"] == leave["robot"]))))
    ]  # fmt: skip

    log = read_sensing_log(written(scratch, HEADER, *lines))

    by_hand = read_sensing_log(written(scratch, HEADER, *final))
    assert content(replace(log, line=None)) == content(by_hand)
    assert {*log.robot_id[log.gone].tolist()} == gone
    assert by_hand.line is None
    assert [entry["robot"] for entry in log_entries(log) if "robot" in entry] == [
        line["robot"] for line in final
    ]
    for number, line in enumerate(at_end):
        assert by_hand.line_of(number) == 2 + final.index(line)
    write_sensing_log(log, scratch)
    assert content(read_sensing_log(scratch)) == content(by_hand)
    # The line of each robot is its last one.
    for number, name in enumerate(log.robot_id.tolist()):
        own = [k for k, line in enumerate(lines, start=2)
               if line["robot"] == name and line.get("event") in {None, "replace"}]  # fmt: skip
        assert log.line_of(number) == own[-1]


def test_only_a_robot_that_left_makes_a_log_one_of_version_3(tmp_path):
    """Other events leave no trace, so that older programs can read what is written again."""
    path = tmp_path / "log"

    stay = read_sensing_log(written(path, HEADER, ANCHOR, JOINER, THIRD, RELEASE, REPLACE))
    leave = read_sensing_log(written(path, HEADER, ANCHOR, JOINER, LEAVE, THIRD))

    assert next(log_entries(stay))["version"] == 2
    assert next(log_entries(leave))["version"] == 3
    events = [entry.get("event") for entry in log_entries(leave)]
    assert events == [None, None, None, "leave", None]
    assert leave.line_of(2) == 5


REFUSED = {
    "robot: the anchor holds all others; start a log": {"event": "leave", "robot": 7},
    "robot: robot 8 is not on an earlier line; let it join": {"event": "leave", "robot": 8},
    "robot: robot -3 has left; delete this line, or": LEAVE,
    "contacts[0]: robot -3 has left; delete": RELEASE,
    "robot: robot -3 has left; delete": {"event": "replace", **JOINER},
    "robot: robot -3 has a line already; give every": JOINER,
    "robot: robot 8 is not": {**RELEASE, "robot": 8},
    "contacts[0]: robot 8 is not": {**RELEASE, "contacts": [[0, 8, 1]]},
    "contacts[0]: robots 5 and 7 do not touch so": {**RELEASE, "contacts": [[0, 7, 0]]},
    "contacts[0]: robots 7 and 5 do not touch so": {**RELEASE, "robot": 7, "contacts": [[0, 5, 1]]},
    "contacts[1]: robots 5 and 7 do not touch so": {**RELEASE, "contacts": [[0, 7, 1]] * 2},
    "contacts[0]: robots 5 and 5 do not touch so": {**RELEASE, "contacts": [[0, 5, 0]]},
    "contacts[0][0]: 1.5 should be": {**RELEASE, "contacts": [[1.5, 7, 1]]},
    "contacts[0][2]: is missing; add it": {**RELEASE, "contacts": [[0, 7]]},
    "contacts: is missing; add it": {"event": "release", "robot": 5},
    "contacts: [] should have at least 1 item": {**RELEASE, "contacts": []},
    "contacts: unknown key": {**LEAVE, "contacts": []},
    "robot: is missing; add it": {"event": "leave"},
    "robot: null should be": {"event": "leave", "robot": None},
    "contacts[0]: robot 5 is not on an earlier line": {
        "event": "replace", **ANCHOR, "contacts": [[0, 5, 0]],
    },
    "contacts[0]: there is no dock 9": {**REPLACE, "contacts": [[9, 7, 0]]},
    "stances[0].pivot_dock: there is no dock 3": {
        **REPLACE, "stances": [{"orientation_wxyz": [1, 0, 0, 0], "pivot_dock": 3}],
    },
    "orientation_wxyz: the anchor's orientation is null": {
        "event": "replace", **ANCHOR, "orientation_wxyz": None,
    },
    'event: "leaves" should be one of leave, release, replace; did you mean leave?': {
        **LEAVE, "event": "leaves",
    },
    "event: [] should be one of": {**LEAVE, "event": []},
    "event: 1 should be one of": {**LEAVE, "event": 1},
}  # fmt: skip


@pytest.mark.parametrize("problem", REFUSED)
def test_an_event_that_contradicts_earlier_lines_is_refused(tmp_path, problem):
    """The message has file, line and key, what is wrong, and what to do."""
    path = written(tmp_path / "log", HEADER, ANCHOR, JOINER, THIRD, LEAVE, REFUSED[problem])

    with pytest.raises(InputError) as refused:
        read_sensing_log(path)

    assert str(refused.value).startswith(f"{path}:6: {problem}")
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("version", [1, 2])
def test_events_need_version_3(tmp_path, version):
    """An older program would take the line for a robot, and refuse it without a remedy."""
    header = {key: value for key, value in HEADER.items() if key != "sources"}
    path = written(tmp_path / "log", {**header, "version": version}, ANCHOR, LEAVE)

    with pytest.raises(InputError, match=f":3: event: version {version} has no events; give vers"):
        read_sensing_log(path)


def test_a_refused_event_changes_nothing(tmp_path):
    """A release of several contacts keeps all of them if one of them is wrong."""
    lines = [HEADER, ANCHOR, JOINER, THIRD]
    log = read_sensing_log(written(tmp_path / "log", *lines))
    builder = builder_of(lines)

    for line in (
        {**RELEASE, "contacts": [[0, 7, 1], [0, 7, 0]]},
        {**REPLACE, "contacts": [[0, 7, 1], [0, 7, 1]]},
        {"event": "leave", "robot": 7},
    ):
        with pytest.raises(InputError):
            builder.take(parse_line(json.dumps(line), builder.header))

    assert content(builder.log()) == content(log)


def builder_of(lines):
    """Make a builder that has taken some lines."""
    from tiswarm.records.sensing_file import SensingLogBuilder  # noqa: PLC0415

    header, *others = map(json.dumps, lines)
    builder = SensingLogBuilder(parse_header(header))
    for line in others:
        builder.take(parse_line(line, builder.header))
    return builder


def test_contacts_that_were_released_or_replaced_make_room_for_others():
    """A dock may have 24 contacts at the end; those that it no longer has do not count."""
    level = [1.0, 0.0, 0.0, 0.0]
    touching = [
        {"robot": name, "orientation_wxyz": level, "contacts": [[0, 7, 0]]}
        for name in range(100, 124)
    ]
    builder = builder_of([HEADER, ANCHOR, *touching])
    one_more = json.dumps({**touching[0], "robot": 200})
    with pytest.raises(InputError, match="dock 0 of robot 7 has more than 24 contacts"):
        builder.add(parse_robot(one_more))

    for event in (
        {"event": "release", "robot": 7, "contacts": [[0, 100, 0]]},
        {"event": "replace", **touching[1], "contacts": []},
    ):
        builder.take(parse_line(json.dumps(event), builder.header))
    builder.add(parse_robot(one_more))
    builder.add(parse_robot(one_more.replace("200", "201")))

    with pytest.raises(InputError, match="dock 0 of robot 7 has more than 24 contacts"):
        builder.add(parse_robot(one_more.replace("200", "202")))
    assert len(builder.log().contacts) == 24


@pytest.mark.parametrize("line", [LEAVE, RELEASE, REPLACE])
def test_the_schema_describes_events(line):
    """Other programs can check their lines by it."""
    jsonschema.validate(line, line_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**line, "robto": 1}, line_schema())


def test_an_event_does_not_join():
    """Calls that take the line of a robot that joins refuse others."""
    with pytest.raises(InputError, match='event: "replace" is about a robot that has joined'):
        parse_robot(json.dumps(REPLACE))


def test_a_robot_that_left_may_be_named_by_later_ones(tmp_path):
    """They touched it while it was there, though their lines come after it has left."""
    log = read_sensing_log(written(tmp_path / "log", HEADER, ANCHOR, JOINER, LEAVE, THIRD))

    assert log.is_gone.tolist() == [False, True, False]
    assert np.isin([1, 2, 2, 1], log.contacts).all()
