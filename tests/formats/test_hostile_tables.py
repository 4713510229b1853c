"""Tables as people save them: they are read as they are, or a line names what is wrong."""

import gzip
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.formats.test_programs import BODY, assert_same
from tests.formats.test_ranges import BEACONS, TAGS, measured, tables
from tests.formats.test_stances import assert_same_stances, sampled
from tiswarm.base.errors import InputError
from tiswarm.formats.imports import convert, import_poses
from tiswarm.formats.poses import Assumptions
from tiswarm.sensing import SensingParams, observe

ROBOTS = 8
HEAD = "robot,x,y,z,qw,qx,qy,qz"


@pytest.fixture(scope="module")
def pose(towers):
    """Positions and orientations of the first robots of a tower."""
    turn = Rotation.from_quat(towers[0].orientation_wxyz[:ROBOTS], scalar_first=True)
    return towers[0].position[:ROBOTS], turn


def quaternion(place, turn):
    """Position, then a quaternion."""
    return [*place, *turn.as_quat(scalar_first=True)]


def rolled(factors):
    """Position, then roll, pitch and yaw, each in a unit."""
    return lambda place, turn: [*place, *turn.as_euler("ZYX")[::-1] * factors]


def table(pose, head=HEAD, cells=quaternion, *, sep=",", end="", names="{}", more=()):
    """Lines of a table, a robot a row."""
    rows = [
        [names.format(k), *map(repr, map(float, cells(place, turn))), *more]
        for k, (place, turn) in enumerate(zip(*pose, strict=True))
    ]
    return [head.replace(",", sep), *(sep.join(row) + end for row in rows)]


def bring_in(path, **known):
    """Import robots with docks of FireAntV3 on the ground."""
    usual = {"dock_offset_body": BODY, "anchors": (0,), "ground_z": 0.0}
    return import_poses(path, Assumptions(**{**usual, **known}))[""]


def with_row_numbers(lines, head):
    """Number rows, as R and pandas do where they print a table."""
    return [head + lines[0], *(f"{k}  {line}" for k, line in enumerate(lines[1:]))]


MATRIX = "r11,r12,r13,r21,r22,r23,r31,r32,r33"


def matrix(place, turn):
    """Position, then a matrix, row by row."""
    return [*place, *turn.as_matrix().ravel()]


LAYOUTS = {
    "a separator behind each row": lambda p: table(p, end=","),
    "blanks and quotes behind commas": lambda p: table(
        p, ", ".join(f'"{name}"' for name in HEAD.split(",")), sep=", "
    ),
    "bars": lambda p: table(p, sep="|"),
    "numbers of rows without a name": lambda p: with_row_numbers(table(p, sep="  "), "   "),
    "quoted names in blanks": lambda p: with_row_numbers(
        table(p, ",".join(f'"{name}"' for name in HEAD.split(",")), sep=" "), ""
    ),
    "prose above the head": lambda p: ["Run 12, Tuesday", "by hand", "", *table(p)],
    "carriage returns": lambda p: ["\r".join(table(p))],
    "units behind a slash": lambda p: table(p, HEAD.replace(",x,y,z", ",x/mm,y/mm,z/mm")),
    "units in words": lambda p: table(p, HEAD.replace(",x,y,z", ",x in mm,y in mm,z in mm")),
    "units of one": lambda p: table(p, "robot,x_[mm],y_[mm],z_[mm],qw [1],qx [1],qy [-],qz [-]"),
    "matrices by row and column": lambda p: table(p, f"robot,x,y,z,{MATRIX}", matrix),
    "matrices from zero": lambda p: table(
        p, "robot,x,y,z,R00,R01,R02,R10,R11,R12,R20,R21,R22", matrix
    ),
    "covariances beside": lambda p: table(
        p, f"{HEAD},cov_x,x_cov,xx,xy,P_zz,speed_x,xdot", more=["9"] * 7
    ),
    "two numbers in names": lambda p: table(p, names="v3_{}/base"),
    "numbers with a fraction": lambda p: table(p, names="{}.0"),
    "an estimate beside": lambda p: table(
        p,
        "robot,est_x,est_y,est_z,gt_x,gt_y,gt_z,qw,qx,qy,qz",
        lambda place, turn: [*place + 1.0, *quaternion(place, turn)],
    ),
}
CHOSEN = {"an estimate beside": {"columns": {"x": "gt_x", "y": "gt_y", "z": "gt_z"}}}


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_read(name, pose, tmp_path):
    """The structure is that of a plain table."""
    for file, lines in (("plain.csv", table(pose)), ("own.csv", LAYOUTS[name](pose))):
        (tmp_path / file).write_text("\n".join(lines) + "\n", newline="")

    found = bring_in(tmp_path / "own.csv", **CHOSEN.get(name, {}))

    assert_same(found, bring_in(tmp_path / "plain.csv"))
    assert found.warnings == []


def named(start):
    """Names of a pose that begin with a word."""
    return ",".join(f"{start}.{name}" for name in HEAD.split(",")[1:])


DEGREES, ROLLED = np.array([180.0 / np.pi] * 3), "robot,x,y,z,roll{0},pitch{0},yaw{0}"
FAULTS = {
    "no names": (lambda p: table(p)[1:], "t.csv:1: there are no names of columns; write robot,x,y"),
    "names in another language": (
        lambda p: table(p, "Körper,Lage X,Lage Y,Lage Z,qw,qx,qy,qz"),
        "rename or add robot,x,y,z, or name columns by --column robot=NAME,x=NAME,y=NAME,z=NAME",
    ),
    "two sets of positions": (
        lambda p: table(
            p,
            f"robot,{named('est')},{named('gt')}",
            lambda place, turn: [*quaternion(place + 1.0, turn), *quaternion(place, turn)],
        ),
        "t.csv:1: positions are in est.x,est.y,est.z and in gt.x,gt.y,gt.z; choose by --column x=",
    ),
    "speeds alone": (
        lambda p: table(p, "robot,speed_x,speed_y,speed_z,qw,qx,qy,qz"), "rename or add x,y,z, or",
    ),
    "angles of two units": (
        lambda p: table(p, "robot,x,y,z,roll_deg,pitch_deg,yaw_rad", rolled(DEGREES)),
        "t.csv:1: the angles have different units: roll in deg, pitch in deg, yaw in rad; convert",
    ),
    "degrees said to be radians": (
        lambda p: table(p, ROLLED.format(" [rad]"), rolled(DEGREES)),
        "angles in deg, read as ZYX, give 12: write [deg] behind their names",
    ),
    "radians said to be degrees": (
        lambda p: table(p, ROLLED.format("_deg"), rolled(1.0)),
        "angles in rad, read as ZYX, give 12: write [rad] behind their names",
    ),
    "the other order, from world to body": (
        lambda p: table((p[0], p[1].inv()), cells=lambda place, turn: [*place, *turn.as_quat()]),
        "quaternions in the other order that turn world to body give 12: rename the columns, and",
    ),
    "one body under two names": (
        lambda p: [*table(p), table(p)[-1].replace(f"{ROBOTS - 1},", "99,", 1)],
        f"docks of these robots are in one place: {ROBOTS - 1} and 99; if they are one body, give",
    ),
    "ground among models": (
        lambda p: [*table(p, names="bot_{}"), "ground_plane,0,0,0,1,0,0,0"],
        "t.csv:10: robot: 'ground_plane' has no number, or several; write it like bot_7, or delete",
    ),
    "a value that is none": (
        lambda p: [*table(p), "8,#N/A,0,0,1,0,0,0"], "t.csv:10: 1 incomplete row, empty or NaN",
    ),
    "a lost body": (
        lambda p: [*table(p), "8,-999,-999,-999,-999,-999,-999,-999"],
        "t.csv:10: qw: the quaternion has length 1998; scale it to 1, write more digits, or delete",
    ),
    "a time without a name": (
        lambda p: [*table(p), table(p)[1]],
        "robot 0 has a row already; keep one, or give the time of each in a column time (--column",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named(name, pose, tmp_path):
    """A refusal with its line, or a warning beside the log."""
    lines, sentence = FAULTS[name]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines(pose)) + "\n")

    try:
        said = "\n".join(bring_in(path).warnings)
    except InputError as refusal:
        said = str(refusal)

    assert sentence in said


OTHER_FILES = {
    "book.xlsx": (b"PK\x03\x04\x14\x00", "book.xlsx: this is a workbook or an archive; save the"),
    "t.parquet": (b"PAR1\x15\x04", "t.parquet: this is a Parquet file; write its table as CSV"),
    "t.csv.gz": (gzip.compress(b"robot,x"), "t.csv.gz: this is a file compressed by gzip; unpack"),
    "unicode.txt": ("robot,x\n".encode("utf-16"), "unicode.txt: this is text in UTF-16; save it"),
    "t.json": (b'[{"robot": 0}]', "t.json: this is JSON; write a table, a robot a row"),
    "log.jsonl": (
        b'{"format": "tiswarm-sensing"}', "log.jsonl: this is a sensing log already; give it to",
    ),
    "page.html": (b"\n<html>", "page.html: this is HTML or XML; save its table as CSV"),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHER_FILES)
def test_a_file_of_another_format_is_named(name, tmp_path):
    """Its first bytes say what it is."""
    data, sentence = OTHER_FILES[name]
    (tmp_path / name).write_bytes(data)

    with pytest.raises(InputError) as refusal:
        bring_in(tmp_path / name)

    assert sentence in str(refusal.value)


@pytest.fixture(scope="module")
def walks(towers):
    """Rows of three robots that walk, robot, pose, frame, and what they sensed."""
    few = replace(towers[0], walks=towers[0].walks[:3], loads=towers[0].loads[:3])
    return sampled(few, steps=5, dwell=3, waiting=False), observe(few, SensingParams())


def clocked(rows, head, cells):
    """Lines of a table whose times are cells of their own."""
    return [f"{head},{HEAD}", *(",".join(map(str, [*cells(row[-1]), *row[:-1]])) for row in rows)]


CLOCKS = {
    "dates": ("time", lambda k: [f"2026-11-27T06:{k // 60:02}:{k % 60:02}.5Z"]),
    "times of a day": ("stamp", lambda k: [f"06:{k // 60:02}:{k % 60:02}.125"]),
    "seconds and nanoseconds": (
        "header.stamp.sec,header.stamp.nanosec", lambda k: [1_700_000_000 + k // 9, k % 9 * 10**8]
    ),
    "nanoseconds": ("timestamp", lambda k: [1_700_000_000_000_000_000 + k * 10**7]),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOCKS)
def test_a_clock_is_read(name, walks, tmp_path):
    """Stances come in order."""
    rows, sensed = walks
    (tmp_path / "t.csv").write_text("\n".join(clocked(rows, *CLOCKS[name])) + "\n")

    assert_same_stances(bring_in(tmp_path / "t.csv").log, sensed)


def test_a_clock_that_is_set_anew_is_refused(walks, tmp_path):
    """Two recordings in one file are no motion; messages that overtake others are."""
    rows, sensed = walks
    middle = rows[len(rows) // 2][-1]
    lines = clocked(rows, "time", lambda k: [k if k < middle else k - middle + 0.5])
    path, late = tmp_path / "t.csv", tmp_path / "late.csv"
    path.write_text("\n".join(lines) + "\n")
    swapped = clocked(rows, "time", lambda k: [k])
    swapped[31:31] = [swapped.pop(40)]
    late.write_text("\n".join(swapped) + "\n")

    with pytest.raises(InputError, match=r"t.csv:\d+: time: the time of robot 0 goes back from "):
        bring_in(path)
    assert_same_stances(bring_in(late).log, sensed)


def test_names_of_files_and_bodies_may_have_more_than_a_number(walks, tmp_path):
    """The number that differs counts; a body without one beside others is no robot."""
    rows, sensed = walks
    names, (folder, wide) = HEAD.split(",")[1:], (tmp_path / "runs", tmp_path / "wide.csv")
    folder.mkdir()
    for robot in range(3):
        lines = [f"{row[-1]},{','.join(map(str, row[1:-1]))}" for row in rows if row[0] == robot]
        text = "\n".join([",".join(["time", *names]), *lines]) + "\n"
        (folder / f"bot_{robot}_2026-11-27.csv").write_text(text)
    bodies = ["ground_plane", "v3_0", "v3_1", "v3_2"]
    seen = {(row[0] + 1, row[-1]): row[1:-1] for row in rows}
    head = ["time", *(f"{body}.{name}" for body in bodies for name in names)]
    lines = [",".join(head)]
    for k in range(rows[-1][-1] + 1):
        poses = [seen.get((b, k), [""] * 7) for b in range(1, 4)]
        lines.append(",".join(map(str, [k, 0, 0, 0, 1, 0, 0, 0, *(c for p in poses for c in p)])))
    wide.write_text("\n".join(lines) + "\n")

    found = bring_in(wide)

    assert_same_stances(bring_in(folder).log, sensed)
    assert_same_stances(found.log, sensed)
    assert "no robots, since their names have no number: ground_plane" in found.notes
    (folder / "README.txt").write_text("of Tuesday\n")
    with pytest.raises(
        InputError, match=r"README.txt: .* move it out of the folder if it is of no"
    ):
        bring_in(folder)


def scaled(rows, factor):
    """Ranges in another unit."""
    return [(tag, beacon, factor * value) for tag, beacon, value in rows]


def drifting():
    """Ranges of tags that move while they range."""
    rng, rows = np.random.default_rng(1), []
    for k in range(12):
        for tag, place in enumerate(TAGS + np.array([0.1 * k, 0.0, 0.0])):
            for beacon, other in enumerate(BEACONS):
                length = np.linalg.norm(place - other) + rng.normal(0.0, 0.02)
                rows.append((f"T{tag}", f"A{beacon}", length))
    return rows


WARNINGS = {
    "another unit": (
        scaled(measured(9), 100.0), {"head": "tag,beacon,range"},
        "cannot be; with ranges in cm and beacons in m they can: convert them to one unit",
    ),
    "a bias": (
        measured(9, late=dict.fromkeys(range(4), -1.5)), {},
        "cannot be: correct places or names of beacons, or give their bias",
    ),
    "a beacon without a place": (
        [*measured(9), ("T1", "A9", 2.0)] * 3, {},
        "ranges are to names without a place, which are located as tags: A9; add their places",
    ),
    "tags that move": (drifting(), {}, "readings of a pair follow each other closely, and drift"),
}  # fmt: skip


@pytest.mark.parametrize("name", WARNINGS)
def test_ranges_that_do_not_fit_are_named(name, tmp_path):
    """A warning says what does not fit, and what would."""
    rows, layout, sentence = WARNINGS[name]
    path, beacons = tables(tmp_path, rows, **layout)

    warnings = convert(path, {"beacons": beacons})[""].warnings

    assert sentence in "\n".join(warnings)


@pytest.mark.parametrize("seed", range(20))
def test_ranges_that_fit_give_no_warning(seed, tmp_path):
    """Noise alone makes no impossible triangle, and no drift."""
    path, beacons = tables(tmp_path, measured(12, seed=seed))

    assert convert(path, {"beacons": beacons})[""].warnings == []


REFUSED = {
    "other names": (
        [(tag, beacon.lower(), value) for tag, beacon, value in measured(3)], {},
        "no range is to a beacon: ranges have a0, a1, a2, a3, a4, beacons are A0, A1, A2, A3, A4; ",
    ),
    "numbers of both": (
        [(tag.replace("T", "A"), *rest) for tag, *rest in measured(3)], {},
        "give tags and beacons different names, such as T1 and A1",
    ),
    "sd in another unit": (
        [(*row, 5.0) for row in measured(1)], {"head": "tag,beacon,range [m],sd [cm]"},
        "ranges.csv:1: sd [cm]: this column is in cm, others in m; convert them to one unit",
    ),
    "bias in another unit": (
        measured(1), {"beacons": "beacon,x [m],y [m],z [m],bias_mm", "more": ",30"},
        "beacons.csv:1: bias_mm: this column is in mm, others in m; convert them to one unit",
    ),
    "equal readings": (
        [row for row in measured(1) for _ in range(5)], {},
        "nothing states how exact ranges are, and repeated readings are equal; add a column sd",
    ),
    "names of columns": (
        measured(1), {"head": "P1,P2,range"},
        "rename or add tag,beacon, or name columns as by --column tag=NAME",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_tables_of_ranges_are_refused(name, tmp_path):
    """A line has what is wrong and what to do."""
    rows, layout, sentence = REFUSED[name]
    path, beacons = tables(tmp_path, rows, **layout)

    with pytest.raises(InputError) as refusal:
        convert(path, {"beacons": beacons})

    assert sentence in str(refusal.value)


def test_columns_of_ranges_are_named(tmp_path, tiswarm):
    """An option names those of both tables; a table without tags is of one."""
    path, beacons = tables(
        tmp_path, measured(5), head="P1;P2;Abstand".replace(";", ","), beacons="P2,x,y,z"
    )
    one, out = tmp_path / "one.csv", tmp_path / "out"
    rows = np.array([row[2] for row in measured(5)]).reshape(5, 4, 5)[:, 0]
    one.write_text("A0,A1,A2,A3,A4\n" + "".join(",".join(map(str, r)) + "\n" for r in rows))

    named = "tag=P1,beacon=P2,range=Abstand"
    done = tiswarm("import", path, "--beacons", beacons, "--column", named, "--out", out)
    wrong = tiswarm("import", path, "--beacons", beacons, "--column", "x1=P1", "--out", out)
    single = convert(one, {"beacons": beacons, "columns": {"beacon": "P2"}})[""]

    assert (done.returncode, wrong.returncode) == (0, 2), done.stderr
    assert "5 beacons, 4 tags, 20 ranges" in done.stdout
    assert "--column: 'x1' is no quantity of ranges; use tag, beacon, range, sd" in wrong.stderr
    assert single.log.robot_count == 6
