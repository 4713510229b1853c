"""Tables that robots recorded themselves become the log of what they sensed."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation, Slerp

import tiswarm
from tests.formats.test_programs import BODY
from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.formats.imports import convert

CONTACTS = ["robot", "dock", "other", "other_dock", "time", "closed"]
TURNS = ["robot", "time", "qw", "qx", "qy", "qz"]
REST_S = 1.0
FLIP_S = 0.5
RATE_HZ = 10.0
GROUND = -1


@pytest.fixture(scope="module")
def log():
    """What a tower of eight robots sensed, with all stances and without noise."""
    return tiswarm.grow("tower", robots=8, seeds=3, quiet=True)[0].sense()


def touches(rows, ground, row):
    """Touches of a stance: (dock, other robot, its dock), the ground as another robot."""
    of_robots = {
        (dock, other, partner) for stance, dock, other, partner in rows.tolist() if stance == row
    }
    return of_robots | {(dock, GROUND, 0) for stance, dock in ground.tolist() if stance == row}


def rests_of(log, robot):
    """Orientation, touches and pivot of each rest of a robot; no pivot at the last."""
    stances = log.stances
    for row in range(stances.start[robot], stances.start[robot + 1]):
        touched = touches(stances.contacts, stances.ground_docks, row)
        yield stances.orientation_wxyz[row], touched, stances.pivot_dock[row]
    final = log.contacts[:, [2, 3, 0, 1]]
    yield log.orientation_wxyz[robot], touches(final, log.ground_docks, robot), None


def recorded(log, folder, *, first_dock=0, spread_deg=0.0):
    """Write the tables that the robots of a log would record, one robot after the other."""
    rng = np.random.default_rng(0)
    changes = []
    turns = []
    time = 0.0
    for robot in range(log.robot_count):
        closed = set()
        before = None
        for wxyz, touched, pivot in rests_of(log, robot):
            if before is not None:
                swing = Slerp([0.0, 1.0], Rotation.from_quat([before, wxyz], scalar_first=True))
                for share in np.arange(0.1, 1.0, 0.2):
                    moving = swing(share).as_quat(scalar_first=True)
                    turns.append((robot, time + share * FLIP_S, moving))
                time += FLIP_S
            changes += [(robot, *touch, time, 1) for touch in sorted(touched - closed)]
            shake = Rotation.from_rotvec(np.deg2rad(spread_deg) * rng.normal(size=(9, 3)))
            held = (shake * Rotation.from_quat(wxyz, scalar_first=True)).as_quat(scalar_first=True)
            turns += [(robot, time + 0.05 + k / RATE_HZ, held[k]) for k in range(9)]
            time += REST_S
            closed = {touch for touch in touched if touch[0] == pivot}
            if pivot is not None:
                changes += [(robot, *touch, time, 0) for touch in sorted(touched - closed)]
            before = wxyz
    table = pd.DataFrame(changes, columns=CONTACTS)
    table["dock"] += first_dock
    table["other_dock"] += first_dock
    is_ground = table["other"] == GROUND
    path = folder / "contacts.csv"
    table[~is_ground].to_csv(path, index=False)
    standing = table[is_ground].drop(columns=["other", "other_dock"])
    standing.to_csv(folder / "ground.csv", index=False)
    rows = [(robot, time, *wxyz) for robot, time, wxyz in turns]
    pd.DataFrame(rows, columns=TURNS).to_csv(folder / "imu.csv", index=False)
    return path


def bring_in(path: Path, **stated):
    """Import tables of robots with the docks of FireAntV3."""
    folder = path.parent
    usual = {
        "orientations": folder / "imu.csv",
        "ground": folder / "ground.csv",
        "length_unit": "R",
    }
    return convert(path, {"dock_offset_body": BODY, **usual, **stated})[""]


@pytest.mark.parametrize("first_dock", [0, 1])
def test_a_recording_is_the_log_of_what_was_sensed(first_dock, log, tmp_path):
    """Rests, flips, pivots and contacts come from closings, openings and orientations."""
    path = recorded(log, tmp_path, first_dock=first_dock)

    imported = bring_in(path)

    np.testing.assert_array_equal(imported.log.contacts, log.contacts)
    np.testing.assert_array_equal(imported.log.ground_docks, log.ground_docks)
    np.testing.assert_allclose(imported.log.anchor_position[2], log.anchor_position[2], atol=1e-6)
    for name in ("start", "pivot_dock", "contacts", "ground_docks"):
        ours = getattr(imported.log.stances, name)
        np.testing.assert_array_equal(ours, getattr(log.stances, name), err_msg=name)
    turn = Rotation.from_quat(imported.log.stances.orientation_wxyz, scalar_first=True)
    true = Rotation.from_quat(log.stances.orientation_wxyz, scalar_first=True)
    assert np.rad2deg((turn * true.inv()).magnitude()).max() < 1e-4
    assert imported.warnings == []


def test_noise_of_orientations_makes_no_flips(log, tmp_path):
    """Rests are those of the contacts; turns that the noise explains are none."""
    path = recorded(log, tmp_path, spread_deg=0.3)

    imported = bring_in(path, tilt_deg=0.3, yaw_deg=0.3)

    np.testing.assert_array_equal(imported.log.stances.start, log.stances.start)
    np.testing.assert_array_equal(imported.log.stances.pivot_dock, log.stances.pivot_dock)
    assert imported.log.noise.tilt_deg == 0.3


def renamed(path, names, robot="Ant{}"):
    """Rename columns of all three tables, and robots."""
    for file in path.parent.glob("*.csv"):
        table = pd.read_csv(file)
        for key in {"robot", "other"} & {*table.columns}:
            table[key] = [robot.format(number) for number in table[key]]
        table.rename(columns=names).to_csv(file, index=False)


def test_a_program_may_name_robots_and_columns(log, tmp_path):
    """Robots have the numbers in their names; --column names the columns."""
    path = recorded(log, tmp_path, first_dock=1)
    renamed(path, {"time": "stamp", "other": "neighbor", "other_dock": "neighbor_dock"})
    named = {"time": "stamp", "other": "neighbor", "other_dock": "neighbor_dock"}

    imported = bring_in(path, columns=named)

    np.testing.assert_array_equal(imported.log.robot_id, log.robot_id)
    np.testing.assert_array_equal(imported.log.contacts, log.contacts)


def keep_final(log, path):
    """Leave final contacts and orientations alone in the tables of a log; no contact opens."""
    rows = [
        (later, dock, robot, partner, 10.0 * later)
        for robot, partner, later, dock in log.contacts.tolist()
    ]
    pd.DataFrame(rows, columns=CONTACTS[:-1]).to_csv(path, index=False)
    imu = path.parent / "imu.csv"
    pd.read_csv(imu).drop_duplicates("robot", keep="last").to_csv(imu, index=False)


def test_contacts_without_openings_last_to_the_end(log, tmp_path):
    """There are no stances before the final ones; robots join as they touch earlier ones."""
    path = recorded(log, tmp_path)
    keep_final(log, path)

    imported = bring_in(path, ground=None)

    assert imported.log.stances is None
    np.testing.assert_array_equal(imported.log.robot_id, log.robot_id)
    np.testing.assert_array_equal(imported.log.contacts, log.contacts)


MISTAKES = {
    "columns": (
        lambda table: table.rename(columns={"other": "neighbor"}),
        {},
        r"contacts.csv:1: the columns are robot,dock,neighbor,.*; .* --column other=NAME",
    ),
    "dock": (
        lambda table: table.assign(dock=table["dock"].replace(2, 9)),
        {},
        r"contacts.csv:\d+: dock: docks count from 0 to 2; correct it, or --first-dock",
    ),
    "state": (
        lambda table: table.assign(closed=2),
        {},
        "contacts.csv:2: closed: 2 is neither 0, open, nor 1, closed; correct it",
    ),
    "itself": (
        lambda table: table.assign(other=table["robot"]),
        {},
        "contacts.csv:2: other: a robot cannot touch itself; name another robot",
    ),
    "orientation": (
        lambda table: table.assign(robot=table["robot"].replace(2, 77)),
        {},
        "imu.csv: there is no orientation of 77; add a row, or delete its contacts",
    ),
    "docks": (
        lambda table: table,
        {"dock_offset_body": None},
        "contacts alone do not say where docks are; give --dock-offset, or --docks",
    ),
    "anchor": (
        lambda table: table,
        {"anchors": (99,)},
        "contacts.csv: anchor: there is no robot 99; name one of the tables",
    ),
    "end": (
        lambda table: table[(table["robot"] != 7) | (table["time"] < table["time"].max() - 0.1)],
        {},
        "imu.csv: robot 7 is in motion at the end; record until a contact closes",
    ),
}
"""Changes of the table of contacts, options, and the lines, by what is wrong."""


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_with_its_line(name, log, tmp_path):
    """A line says which file, line and column, and what to do."""
    path = recorded(log, tmp_path)
    change, stated, line = MISTAKES[name]
    change(pd.read_csv(path)).to_csv(path, index=False)

    with pytest.raises(InputError, match=line):
        bring_in(path, **stated)


@pytest.mark.parametrize("option", [{"heights": True}, {"up": "y"}, {"gap": 0.1}], ids=str)
def test_options_of_poses_are_refused(option, log, tmp_path):
    """They would have no effect, since the recording has no poses."""
    path = recorded(log, tmp_path)
    [name] = option

    with pytest.raises(InputError, match=r"needs poses.*leave it out") as error:
        bring_in(path, **option)

    assert error.value.argument == name


def test_docks_that_count_from_an_unknown_number_are_refused(log, tmp_path):
    """Docks 1 and 2 of three may be those of either count; --first-dock states it."""
    path = recorded(log, tmp_path)
    keep_final(log, path)
    table = pd.read_csv(path)
    table[(table["dock"] != 0) & (table["other_dock"] != 0)].to_csv(path, index=False)

    with pytest.raises(InputError, match=r"docks 1, 2 of 3 may count from 0 or .*; give --first-"):
        bring_in(path, ground=None)
    assert bring_in(path, ground=None, first_dock=0).log.contacts[:, [1, 3]].min() == 1


def test_the_example_leads_from_tables_to_positions(tmp_path):
    """The tables of twelve robots, with half a degree of noise, give their places."""
    example = REPOSITORY / "scenarios" / "examples" / "own-recording"
    tables = {"orientations": example / "orientations.csv", "ground": example / "ground.csv"}
    noise = {"tilt_deg": 0.5, "yaw_deg": 0.5}

    tiswarm.import_poses(
        example / "contacts.csv",
        out=tmp_path,
        dock_offset_body=BODY,
        length_unit="R",
        **tables,
        **noise,
    )
    estimate = tiswarm.read_log(tmp_path / "sensing.jsonl").localize(quiet=True)

    truth = pd.read_csv(example / "truth.csv").set_index("robot")
    error = estimate.position - truth.loc[estimate.robot_id].to_numpy()
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.5
