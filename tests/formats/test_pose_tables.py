"""Tables of poses are read however a program wrote them: names, units, separators, gaps."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.formats.imports import import_poses
from tiswarm.formats.poses import Assumptions
from tiswarm.records.sensing_file import log_entries

BODY = RobotGeometry().dock_offset_body
COLUMNS = ("robot", "x", "y", "z", "qw", "qx", "qy", "qz")


@pytest.fixture(scope="module")
def rows(towers):
    """Poses of a tower's first 12 robots, as texts in the order of `COLUMNS`."""
    poses = zip(towers[0].position.tolist(), towers[0].orientation_wxyz.tolist(), strict=True)
    return [[str(robot), *map(repr, [*place, *turn])] for robot, (place, turn) in enumerate(poses)][
        :12
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder for the tables of all examples of a property."""
    return tmp_path_factory.mktemp("tables")


def bring_in(path, lines, **known):
    """Import the lines of a table whose docks are FireAntV3's."""
    path.write_text("\n".join(lines) + "\n")
    return import_poses(path, Assumptions(dock_offset_body=BODY, anchors=(0,), **known))[""]


def content(imported, *, but=("length_unit",)):
    """The lines of a log, without some keys of the header."""
    header, *robots = log_entries(imported.log)
    return [{key: value for key, value in header.items() if key not in but}, *robots]


@given(
    order=st.permutations(range(12)),
    places=st.permutations(range(8)),
    separator=st.sampled_from([",", ";", "\t"]),
    decimal=st.sampled_from(".,"),
    unit=st.sampled_from(["{}", "{}_mm", "{} [mm]", "{}(mm)", "{} [ mm ]"]),
    name=st.sampled_from(["robot", "id", "robot_id", "Robot_ID"]),
)
def test_the_way_of_writing_a_table_changes_no_log(
    rows, folder, order, places, separator, decimal, unit, name
):
    """Any order of rows and columns, separator, decimal sign, name and unit give one log."""
    decimal = "." if separator == "," else decimal
    names = [name, *map(unit.format, "xyz"), *COLUMNS[4:]]
    lines = [names, *([cell.replace(".", decimal) for cell in rows[row]] for row in order)]
    table = [separator.join(line[place] for place in places) for line in lines]

    found = bring_in(folder / "any.csv", table)
    plain = bring_in(folder / "plain.csv", [",".join(COLUMNS), *map(",".join, rows)])

    assert found.log.length_unit == ("unit" if unit == "{}" else "mm")
    # Without a join order, robots that are equally near to the anchor keep the order of the file.
    assert by_name(found) == by_name(plain)
    np.testing.assert_array_equal(
        found.position[found.log.robot_id.argsort()], plain.position[plain.log.robot_id.argsort()]
    )


def by_name(imported):
    """Content of a log that does not depend on the join order: header, orientations, contacts."""
    header, *robots = content(imported)
    names = {robot["robot"]: robot["orientation_wxyz"] for robot in robots}
    contacts = {
        frozenset([(robot["robot"], dock), (other, its)])
        for robot in robots
        for dock, other, its in robot["contacts"]
    }
    return header, names, contacts


@given(order=st.permutations(range(12)))
def test_the_order_of_rows_changes_no_log_with_a_join_order(rows, folder, order):
    """With a column `join`, logs are equal line by line."""
    lines = [",".join([*row, str(join)]) for join, row in enumerate(rows)]
    header = ",".join([*COLUMNS, "join"])

    found = bring_in(folder / "any.csv", [header, *(lines[row] for row in order)])

    assert content(found) == content(bring_in(folder / "plain.csv", [header, *lines]))


def test_columns_that_are_not_found_are_listed(tmp_path):
    """The line has the names of the file, and those that it lacks."""
    problem = (
        "t.csv:1: the columns are neither robot,x,y,z,qw,qx,qy,qz nor robot,sphere,x,y,z but "
        "label,x [mm],y [mm],z [mm],heading; rename or add robot,qw,qx,qy,qz, or name"
    )

    with pytest.raises(InputError, match=re.escape(problem)):
        bring_in(tmp_path / "t.csv", ["label;x [mm];y [mm];z [mm];heading", "1;2;3;4;5"])


@pytest.mark.parametrize("other", ["vel", "std", "cmd", "est"])
def test_only_units_of_length_name_positions(rows, tmp_path, other):
    """Velocities and deviations come first in many tables, and change nothing in the log."""
    names = [f"{axis}_{other}" for axis in "xyz"]
    turned = [f"{name}_{other}" for name in COLUMNS[4:]]
    header = ",".join([*names, "robot", "x_m", "y_m", "z_m", *turned, *COLUMNS[4:]])
    lines = [",".join(["9", "8", "7", *row[:4], "1", "0", "0", "0", *row[4:]]) for row in rows]

    found = bring_in(tmp_path / "t.csv", [header, *lines])

    plain = bring_in(tmp_path / "plain.csv", [",".join(COLUMNS), *map(",".join, rows)])
    assert found.log.length_unit == "m"
    assert content(found) == content(plain)


@pytest.mark.parametrize(
    ("axes", "problem"),
    [
        ("x,y,z,x_m,y_m,z_m", "positions are in x,y,z and in x_m,y_m,z_m; keep one, or rename the"),
        ("x_m,y_m,z_m,x [mm]", "positions are in x_m and in x [mm]; keep one, or rename the"),
        ("x,y,z,X", "positions are in x and in X; keep one, or rename the others"),
        ("x,y,y,z", "positions are in y and in y; keep one, or rename the others"),
        ("x [m],y [mm],z", "the axes have different units: x in m, y in mm, z in none; convert"),
        ("x_vel,y_vel,z_vel", "x_vel: 'vel' is no known unit of length; rename it to one of m, cm"),
        ("x_vel,y_m,z_m", "robot,x_vel,y_m,z_m,qw,qx,qy,qz; rename or add x"),
        ("x,y,z,robot", "robot: there are 2 columns of this name; rename all but one"),
    ],
)
def test_positions_that_are_in_doubt_are_refused(tmp_path, axes, problem):
    """The line names the columns between which a reader has to choose, or their units."""
    header = f"robot,{axes},qw,qx,qy,qz"
    row = ",".join(["0", *"12345678"[: axes.count(",") + 1], *"1000"])

    with pytest.raises(InputError, match=re.escape(problem)):
        bring_in(tmp_path / "t.csv", [header, row])


def test_a_unit_that_an_option_names_is_a_unit_of_length(rows, tmp_path):
    """Simulators have units of their own."""
    header = ",".join(["robot", "x_voxel", "y_voxel", "z_voxel", *COLUMNS[4:]])

    found = bring_in(tmp_path / "t.csv", [header, *map(",".join, rows)], length_unit="voxel")

    assert found.log.length_unit == "voxel"


@pytest.mark.parametrize("name", ["{}", "pose.{}", "/odom/pose/pose/{}"])
def test_tables_of_ros_messages_are_read(rows, tmp_path, name):
    """Names of messages, of robots too; twists and stamps beside them count for nothing."""
    sign = "/" if "/" in name else "."
    pose = [name.format(f"position{sign}{axis}") for axis in "xyz"]
    pose += [name.format(f"orientation{sign}{axis}") for axis in "xyzw"]
    header = ["header.frame_id", "robot_name", *pose, *(f"twist.linear.{axis}" for axis in "xyz")]
    lines = [
        ",".join(["map", f"bot_{row[0]}", *row[1:4], *row[5:8], row[4], "7", "8", "9"])
        for row in rows
    ]

    found = bring_in(tmp_path / "t.csv", [",".join(header), *lines])

    plain = bring_in(tmp_path / "plain.csv", [",".join(COLUMNS), *map(",".join, rows)])
    assert content(found) == content(plain)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("alice", "robot_name: 'alice' has no number, or several; write it like bot_7"),
        ("bot_2_7", "robot_name: 'bot_2_7' has no number, or several; write it like bot_7"),
        ("arm_1", "robot_name: 'arm_1' has the number of another robot; give each its own"),
    ],
)
def test_names_that_number_no_robot_are_refused(rows, tmp_path, name, problem):
    """The line has the name: two robots never become one."""
    lines = [",".join([f"bot_{row[0]}", *row[1:]]) for row in rows]
    lines[5] = ",".join([name, *rows[5][1:]])

    with pytest.raises(InputError, match=re.escape(f"t.csv:7: {problem}")):
        bring_in(tmp_path / "t.csv", [",".join(["robot_name", *COLUMNS[1:]]), *lines])


def test_incomplete_rows_are_listed_at_once(rows, tmp_path):
    """They are refused by line and number, or dropped on demand; a note says so."""
    lines = [",".join(COLUMNS), *map(",".join, rows)]
    gaps = lines.copy()
    for line, place, cell in ((2, 1, ""), (3, 7, "NaN"), (4, 4, "null"), (9, 0, " ")):
        cells = lines[line].split(",")
        cells[place] = cell
        gaps[line] = ",".join(cells)
    problem = "t.csv:3: 4 incomplete rows, empty or NaN: line 3-5, 10; complete them, or drop them"

    with pytest.raises(InputError, match=re.escape(problem)):
        bring_in(tmp_path / "t.csv", gaps)
    dropped = bring_in(tmp_path / "t.csv", gaps, drop_incomplete=True)

    left = [line for place, line in enumerate(lines) if place not in {2, 3, 4, 9}]
    assert content(dropped) == content(bring_in(tmp_path / "left.csv", left))
    assert dropped.notes[0] == "4 incomplete rows dropped: line 3-5, 10"
    with pytest.raises(InputError, match="no row is complete; add one for each robot"):
        bring_in(tmp_path / "t.csv", [lines[0], ",,,,,,,"], drop_incomplete=True)


def test_further_columns_may_be_empty(rows, tmp_path):
    """Only numbers that the log needs count; a time needs a number where robots have several."""
    lines = [f"{','.join(COLUMNS)},time,note", *(f"{','.join(row)},," for row in rows)]

    imported = bring_in(tmp_path / "t.csv", lines)

    assert imported.log.robot_count == 12
    with pytest.raises(InputError, match=r"t.csv:2: 13 incomplete rows, empty or NaN: line 2-14;"):
        bring_in(tmp_path / "t.csv", [*lines, lines[1]])


def test_the_shipped_example_gives_the_same_in_other_words(tmp_path):
    """Semicolons, decimal commas and brackets change nothing in its log."""
    example = REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv"
    text = example.read_text().replace(",", ";").replace(".", ",")
    other = tmp_path / "other.csv"
    other.write_text(re.sub(r"(\w)_cm", r"\1 [cm]", text).replace("robot", "id"))

    found = import_poses(other, Assumptions(dock_radius=0.5))[""]

    expected = import_poses(example, Assumptions(dock_radius=0.5))[""]
    assert content(found, but=()) == content(expected, but=())
    assert found.notes == expected.notes
