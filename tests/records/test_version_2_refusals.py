"""A malformed item of a list of version 2 is refused with file, line, key and a way out."""

import json

import pytest

from tests.records.test_sensing_refusals import ANCHOR, HEADER, JOINER, STANCE
from tiswarm.base.errors import InputError
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import LISTS

NAN = float("nan")
NEW_LISTS = [name for name, key in LISTS.items() if key.version == 2]

LINKS = [
    # what directions and connections have in common: own dock, other robot and its dock
    ([], 0, "", "are missing; add them"),
    ([0, 10, 1], 0, "", "are missing; add them"),
    ([3, 10, 1], ..., "", "there is no dock 3; the header has docks 0 to 2"),
    ([-1, 10, 1], ..., "", "there is no dock -1; the header has docks 0 to 2"),
    ([None, 10, 1], ..., "[0]", "null should be a whole number"),
    ([1.5, 10, 1], ..., "[0]", "1.5 should be a whole number"),
    (["0", 10, 1], ..., "[0]", '"0" should be a whole number'),
    ([True, 10, 1], ..., "[0]", "true should be a whole number"),
    ([0, 12, 1], ..., "", "robot 12 is not on an earlier line"),
    ([0, 11, 1], ..., "", "the robot touches itself"),
    ([0, 10.0, 1], ..., "[1]", "10.0 should be a whole number"),
    ([0, None, 1], ..., "[1]", "null should be a whole number"),
    ([0, 10, 3], ..., "", "there is no dock 3; the header has docks 0 to 2"),
    ([0, 10, -2], ..., "", "there is no dock -2; the header has docks 0 to 2"),
    ([0, 10, 0.5], ..., "[2]", "0.5 should be a whole number"),
    ([0, 10, []], ..., "[2]", "[] should be a whole number"),
]
"""Start of the item, then ... for what is right or 0 for nothing; where, and the problem."""


def _links(measured):
    return [([*item, *(measured if rest is ... else [])], where, problem)
            for item, rest, where, problem in LINKS]  # fmt: skip


MALFORMED = {
    "fixes": [
        ([1, 0, 0, 2], "[4]", "is missing; add it"),
        ([1, 0, 0, 2, 0.1, 0], "[5]", "0 should be text"),
        ([1, 0, 0, 2, 0.1, "camera", None], "", "should have at most 6 items"),
        ([1, 0, 0, 2, 0.1, "cam"], "", 'the header has no source "cam"; add it to sources there'),
        ([1, 0, 0, 2, "camera"], "[4]", '"camera" should be a number'),
        ([], "", "are missing; add them"),
        ([1, 1, 0, 2, 0.1], "", "the direction has length 1.41421; scale it to 1"),
        ([0, 0, 0, 2, 0.1], "", "the direction has length 0; scale it to 1"),
        ([1e200, 0, 0, 2, 0.1], "", "the direction has length 1e+200; scale it to 1"),
        ([NAN, 0, 0, 2, 0.1], "[0]", "NaN should be a finite number"),
        (["x", 0, 0, 2, 0.1], "[0]", '"x" should be a number'),
        ([1, 0, 0, 1e99, 1], "", "1e+99 should be within 1e+10 R of"),
        ([1, 0, 0, float("inf"), 1], "[3]", "Infinity should be a finite number"),
        ([1, 0, 0, None, 1], "[3]", "null should be a number"),
        ([1, 0, 0, 2, 0], "", "0.0 should be from 1e-06 to 1e+06"),
        ([1, 0, 0, 2, -1], "", "-1.0 should be from 1e-06 to 1e+06"),
        ([1, 0, 0, 2, 1e7], "", "10000000.0 should be from 1e-06 to 1e+06"),
        ({"x": 1}, "", "should be a list"),
    ],
    "ranges": [
        ([10, 2], "[2]", "is missing; add it"),
        ([10, 2, 0.1, 0], "[3]", "0 should be text"),
        ([10, 2, 0.1, "camera", "camera"], "", "not 5; name one source, and add the variance of"),
        ([10, 2, 0.1, ""], "", 'the header has no source ""; add it to sources there'),
        ([12, 2, 0.1], "", "robot 12 is not on an earlier line"),
        ([11, 2, 0.1], "", "the robot touches itself"),
        ([10.0, 2, 0.1], "[0]", "10.0 should be a whole number"),
        ([None, 2, 0.1], "[0]", "null should be a whole number"),
        (["10", 2, 0.1], "[0]", '"10" should be a whole number'),
        ([10, 0, 0.1], "", "the distance 0 should be positive"),
        ([10, -2, 0.1], "", "the distance -2 should be positive"),
        ([10, 1e99, 0.1], "", "1e+99 should be within 1e+10 R of"),
        ([10, NAN, 0.1], "[1]", "NaN should be a finite number"),
        ([10, "2", 0.1], "[1]", '"2" should be a number'),
        ([10, 2, 0], "", "should be from 1e-06 to 1e+06"),
        ([10, 2, 1e7], "", "should be from 1e-06 to 1e+06"),
        (10, "", "should be a list"),
    ],
    "directions": [
        *_links([1, 0, 0]),
        ([0, 10, 1, 1, 0], "[5]", "is missing; add it"),
        ([0, 10, 1, 1, 0, 0, 0], "", "should have at most 6 items"),
        ([0, 10, 1, 1, 1, 0], "", "the direction has length 1.41421; scale it to 1"),
        ([0, 10, 1, 0, 0, 0], "", "the direction has length 0; scale it to 1"),
        ([0, 10, 1, 0, 0, 0.99], "", "the direction has length 0.99; scale it to 1"),
        ([0, 10, 1, 1e200, 0, 0], "", "the direction has length 1e+200; scale it to 1"),
        ([0, 10, 1, NAN, 0, 0], "[3]", "NaN should be a finite number"),
        ([0, 10, 1, 0, "up", 0], "[4]", '"up" should be a number'),
        ([0, 10, 1, 0, 0, None], "[5]", "null should be a number"),
        ([0, 10, 1, [1, 0, 0], 0, 0], "[3]", "should be a number"),
    ],
    "connections": [
        *_links([1, 0, 0, 0]),
        ([0, 10, 1, 1, 0, 0], "[6]", "is missing; add it"),
        ([0, 10, 1, 1, 0, 0, 0, 0], "", "should have at most 7 items"),
        ([0, 10, 1, 1, 1, 0, 0], "", "the quaternion has length 1.41421; scale it to 1"),
        ([0, 10, 1, 0, 0, 0, 0], "", "the quaternion has length 0; scale it to 1"),
        ([0, 10, 1, 0.9, 0, 0, 0], "", "the quaternion has length 0.9; scale it to 1"),
        ([0, 10, 1, *[-1e308] * 4], "", "the quaternion has length inf; scale it to 1"),
        ([0, 10, 1, NAN, 0, 0, 0], "[3]", "NaN should be a finite number"),
        ([0, 10, 1, 1, 0, 0, "0"], "[6]", '"0" should be a number'),
        ([0, 10, 1, None, 0, 0, 0], "[3]", "null should be a number"),
    ],
    "touches": [
        ([], "", "are missing; add them"),
        ([None, 10], "[2]", "is missing; add it"),
        ([None, 10, None, None], "", "should have at most 3 items"),
        ([0, 10, 1], "", "both docks are known; list the contact in contacts"),
        ([3, 10, None], "", "there is no dock 3; the header has docks 0 to 2"),
        ([-1, 10, None], "", "there is no dock -1; the header has docks 0 to 2"),
        ([None, 10, 3], "", "there is no dock 3; the header has docks 0 to 2"),
        ([None, 10, -1], "", "there is no dock -1; the header has docks 0 to 2"),
        ([None, 12, None], "", "robot 12 is not on an earlier line"),
        ([None, 11, None], "", "the robot touches itself"),
        ([None, None, None], "[1]", "null should be a whole number"),
        ([None, 10.0, None], "[1]", "10.0 should be a whole number"),
        ([0.5, 10, None], "[0]", "0.5 should be a whole number"),
        (["", 10, None], "[0]", '"" should be a whole number'),
        ([None, 10, True], "[2]", "true should be a whole number"),
        (10, "", "should be a list"),
    ],
    "displacements": [
        ([10, 1, 2, 3], "[4]", "is missing; add it"),
        ([10, 1, 2, 3, 0.1, "camera"], "", "should have at most 5 items"),
        ([12, 1, 2, 3, 0.1], "", "robot 12 is not on an earlier line"),
        ([11, 1, 2, 3, 0.1], "", "the robot touches itself"),
        ([10, 0, 0, 0, 0.1], "", "the vector has length 0; correct it"),
        ([10, 1, 2, 1e99, 0.1], "", "should be within 1e+10 R of"),
        ([10, 1, NAN, 3, 0.1], "[2]", "NaN should be a finite number"),
        ([10, 1, 2, 3, 0], "", "should be from 1e-06 to 1e+06"),
        (10, "", "should be a list"),
    ],
}
"""Of each list: an item, where in it the mistake is, and the problem."""

RIGHT = {
    "fixes": [1, 0, 0, 2, 0.1],
    "ranges": [10, 2, 0.1],
    "directions": [0, 10, 1, 1, 0, 0],
    "connections": [0, 10, 1, 1, 0, 0, 0],
    "touches": [None, 10, None],
    "displacements": [10, 1, 2, 3, 0.1],
}

REPEATED = [
    (name, RIGHT[name], None, f"repeats {name}[0]; list it once")
    for name in NEW_LISTS
    if not LISTS[name].repeats
]
CASES = [
    (name, in_stance, *case)
    for name, *case in [*((name, *case) for name in MALFORMED for case in MALFORMED[name]),
                        *REPEATED]
    for in_stance in (False, True)
]  # fmt: skip


def refusal_of(path, *lines):
    """Return the message with which a file of these lines is refused, without its path."""
    path.write_text("".join(f"{json.dumps(entries)}\n" for entries in lines))
    with pytest.raises(InputError) as refusal:
        read_sensing_log(path)
    assert "\n" not in str(refusal.value)
    return str(refusal.value).removeprefix(f"{path}:")


@pytest.mark.parametrize(("name", "in_stance", "item", "where", "problem"), CASES)
def test_a_malformed_item_is_refused_with_its_place(
    tmp_path, name, in_stance, item, where, problem
):
    """The second item of a list is at fault, of the robot's line or of its second stance."""
    items = {name: [RIGHT[name], item]}
    joiner = (
        {**JOINER, "stances": [STANCE, {**STANCE, **items}]} if in_stance else {**JOINER, **items}
    )
    prefix = "stances[1]." if in_stance else ""

    header = {**HEADER, "version": 2, "sources": {"camera": {"shared_sd": 0.5}}}

    refused = refusal_of(tmp_path / "log", header, ANCHOR, joiner)

    assert refused.startswith(f"3: {prefix}{name}[1]{where or ''}")
    assert problem.replace(f"{name}[0]", f"{prefix}{name}[0]") in refused


def test_every_list_of_version_2_is_tried():
    """The table has many mistakes of each, and an item without one."""
    assert sorted(MALFORMED) == sorted(RIGHT) == sorted(NEW_LISTS)
    assert len(CASES) >= 120


SOURCES = [
    ([], "sources", "[] should be"),
    ({"": {"shared_sd": 1}}, "sources: ", 'name "" should be 1 to 40 printable characters'),
    ({"x" * 41: {"shared_sd": 1}}, "sources: ", "should be 1 to 40 printable characters"),
    ({" x": {"shared_sd": 1}}, "sources: ", 'name " x" should be 1 to 40 printable characters'),
    ({"x\n": {"shared_sd": 1}}, "sources: ", "characters without spaces around them; correct it"),
    ({"x": {}}, "sources.x.shared_sd", "is missing; add it"),
    ({"x": 0.5}, "sources.x", "0.5 should be"),
    ({"x": {"shared": 1}}, "sources.x", "is missing; add it"),
    ({"x": {"shared_sd": 1, "shared": 1}}, "sources.x.shared", "did you mean shared_sd?"),
    ({"x": {"shared_sd": "1"}}, "sources.x.shared_sd", '"1" should be a number'),
    ({"x": {"shared_sd": None}}, "sources.x.shared_sd", "null should be a number"),
    ({"x": {"shared_sd": NAN}}, "sources.x.shared_sd", "NaN should be a finite number"),
    ({"x": {"shared_sd": 0}}, "sources.x.shared_sd", "0.0 should be from 1e-06 to 1e+06; correct"),
    ({"x": {"shared_sd": -1}}, "sources.x.shared_sd", "-1.0 should be from 1e-06 to 1e+06"),
    ({"x": {"shared_sd": 1e7}}, "sources.x.shared_sd", "10000000.0 should be from 1e-06 to 1e+06"),
]
"""What `sources` may not be, where the mistake is, and the problem."""


@pytest.mark.parametrize(("sources", "where", "problem"), SOURCES)
def test_a_source_has_a_name_and_a_shared_error(tmp_path, sources, where, problem):
    """Where no error is shared, no source is needed, so that an sd of 0 is a mistake."""
    header = {**HEADER, "version": 2, "sources": sources}

    refused = refusal_of(tmp_path / "log", header, ANCHOR, JOINER)

    assert refused.startswith(f"1: {where}")
    assert problem in refused


def test_a_source_stands_once_in_the_header(tmp_path):
    """Of two shared errors for one name, one would be lost in silence."""
    path = tmp_path / "log"
    header = json.dumps({**HEADER, "version": 2, "sources": ...}, default=lambda _: "here")
    twice = '{"cam": {"shared_sd": 1}, "cam": {"shared_sd": 2}}'
    path.write_text(header.replace('"here"', twice))

    with pytest.raises(InputError, match=r":1: cam: the key stands twice"):
        read_sensing_log(path)


def test_version_1_has_no_sources(tmp_path):
    """A program that reads version 1 alone would take their measurements to be independent."""
    header = {**HEADER, "sources": {"camera": {"shared_sd": 0.5}}}

    refused = refusal_of(tmp_path / "log", header, ANCHOR, JOINER)

    assert refused == "1: sources: version 1 has no such key; give version 2 in the header"


@pytest.mark.parametrize("name", NEW_LISTS)
@pytest.mark.parametrize("in_stance", [False, True])
def test_version_1_has_none_of_the_lists(tmp_path, name, in_stance):
    """A program that reads version 1 alone would refuse the key."""
    items = {name: [RIGHT[name]]}
    joiner = {**JOINER, "stances": [{**STANCE, **items}]} if in_stance else {**JOINER, **items}

    refused = refusal_of(tmp_path / "log", HEADER, ANCHOR, joiner)

    assert refused.startswith("3: stances[0]." if in_stance else "3: ")
    assert refused.endswith(f"{name}: version 1 has no such key; give version 2 in the header")


OTHERS = [
    # version, changes of the header, of the anchor and of the joiner; place and problem
    (1, {}, {}, {"orientation_wxyz": None}, "3: orientation_wxyz", "null needs version 2"),
    (2, {}, {"orientation_wxyz": None}, {}, "2: orientation_wxyz", "orientation is null; give it"),
    (
        2,
        {},
        {},
        {"orientation_wxyz": None, "stances": [STANCE]},
        "3: orientation_wxyz",
        "null leaves the stances without an end; give an orientation or no stances",
    ),
    (
        2,
        {},
        {},
        {"stances": [{**STANCE, "orientation_wxyz": None}]},
        "3: stances[0].orientation_wxyz",
        "null should be a list",
    ),
    (1, {"direction_deg": 1}, {}, {}, "1: noise.direction_deg", "version 1 has no such key"),
    (1, {"connection_deg": 1}, {}, {}, "1: noise.connection_deg", "version 1 has no such key"),
    (2, {"direction_deg": -1}, {}, {}, "1: noise.direction_deg", "-1 should be greater than"),
    (2, {"direction_deg": 181}, {}, {}, "1: noise.direction_deg", "181 should be less than"),
    (2, {"connection_deg": 1e-12}, {}, {}, "1: noise.connection_deg", "should be 0 or at least"),
    (2, {"connection_deg": "1"}, {}, {}, "1: noise.connection_deg", '"1" should be a number'),
]


@pytest.mark.parametrize(("version", "noise", "anchor", "joiner", "place", "problem"), OTHERS)
def test_noise_and_missing_compasses_are_checked(
    tmp_path, version, noise, anchor, joiner, place, problem
):
    """Noise has limits, and a null orientation has conditions."""
    header = {**HEADER, "version": version, "noise": {"tilt_deg": 1.0, "yaw_deg": 2.0, **noise}}

    refused = refusal_of(tmp_path / "log", header, {**ANCHOR, **anchor}, {**JOINER, **joiner})

    assert refused.startswith(f"{place}: ")
    assert problem in refused
