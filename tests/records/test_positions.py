"""Positions come back from their table; malformed tables are refused with file and line."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.structures import Rule, structure
from tiswarm.base.errors import InputError
from tiswarm.records.estimate import Estimate, Observability
from tiswarm.records.positions import (
    read_estimate,
    read_positions,
    read_positions_of,
    write_estimate,
    write_positions,
)

COLUMNS = "robot,x_R,y_R,z_R[,sd_R][,within_1R][,known][,gone][,yaw_deg][,undetermined]"


@settings(max_examples=40)
@given(
    position=hnp.arrays(
        np.float64,
        st.tuples(st.integers(1, 5), st.just(3)),
        elements=st.floats(-1e22, 1e22, allow_subnormal=False),
    ),
    first=st.integers(-(2**63), 2**63 - 6),
)
def test_positions_come_back_bit_for_bit(scratch, position, first):
    """Names and coordinates are the same numbers after a round trip."""
    robot_id = np.arange(len(position), dtype=np.int64) + first
    write_positions(scratch, robot_id, position)

    names, back, _ = read_positions(scratch)

    assert names.tolist() == robot_id.tolist()
    assert back.tobytes() == position.tobytes()


def test_the_table_looks_as_documented(tmp_path):
    """Column names state the unit; an unknown standard deviation is an empty cell."""
    path = tmp_path / "estimate.csv"
    position = np.array([[0.0, 1.0, -2.5], [1e-9, 1 / 3, 1e22]])

    write_positions(path, np.array([7, 3]), position, {"sd_R": [0.25, ""]})

    assert path.read_text() == (
        "robot,x_R,y_R,z_R,sd_R\n7,0.0,1.0,-2.5,0.25\n3,1e-09,0.3333333333333333,1e+22,\n"
    )
    assert read_positions(path)[0].tolist() == [7, 3]

    write_positions(
        path, np.array([7, 3]), position, {"known": ["yes", "floppy"], "yaw_deg": [0.0, -9.0]}
    )

    assert path.read_text() == (
        "robot,x_R,y_R,z_R,known,yaw_deg\n7,0.0,1.0,-2.5,yes,0.0\n"
        "3,1e-09,0.3333333333333333,1e+22,floppy,-9.0\n"
    )
    assert read_positions(path)[0].tolist() == [7, 3]


def test_another_unit_is_not_taken_for_ours(tmp_path):
    """The reader refuses a table in another unit than the expected one."""
    path = tmp_path / "truth.csv"
    write_positions(path, np.array([0]), np.zeros((1, 3)), length_unit="mm")

    names, *_ = read_positions(path, length_unit="mm")

    assert names.tolist() == [0]
    with pytest.raises(InputError, match=re.escape(f"columns are not {COLUMNS}; rename")):
        read_positions(path)


def test_a_position_that_is_not_finite_is_not_written(tmp_path):
    """The writer refuses a position that is not finite."""
    with pytest.raises(ValueError, match="finite"):
        write_positions(tmp_path / "t.csv", np.array([0]), np.full((1, 3), np.nan))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", f"{{path}}:1: the columns are not {COLUMNS}; rename them"),
        ("robot,x,y,z\n", f"{{path}}:1: the columns are not {COLUMNS}; rename them"),
        ("robot,x_R,y_R,z_R\n", "{path}:2: there are no robots; add a row for each"),
        ("robot,x_R,y_R,z_R\n1,0,0\n", "{path}:2: has 3 cells; 4 are needed"),
        ("robot,x_R,y_R,z_R\n1,0,0,0\n\n", "{path}:3: has 0 cells; 4 are needed"),
        ("robot,x_R,y_R,z_R\n1,0,0,0\n1,0,0,0\n", "{path}:3: robot: robot 1 has a row already;"),
        ("robot,x_R,y_R,z_R\na,0,0,0\n", "{path}:2: robot: 'a' is not a whole number; write it"),
        ("robot,x_R,y_R,z_R\n1_0,0,0,0\n", "{path}:2: robot: '1_0' is not a whole number;"),
        (
            "robot,x_R,y_R,z_R\n1,0,nan,0\n",
            "{path}:2: y_R: 'nan' is not a finite number up to 1e+22; write",
        ),
        (
            "robot,x_R,y_R,z_R\n1,0,0,x\n",
            "{path}:2: z_R: 'x' is not a finite number up to 1e+22; write",
        ),
        ("robot,x_R,y_R,z_R\n1,0,-1e308,0\n", "{path}:2: y_R: '-1e308' is not a finite number up"),
        ("robot,x_R,y_R,z_R,sd_R\n1,0,0,0,inf\n", "{path}:2: sd_R: 'inf' is not a finite"),
        ("robot,x_R,y_R,z_R,known,yaw_deg\n1,0,0,0,,?\n", "{path}:2: yaw_deg: '?' is not a finite"),
        ("robot,x_R,y_R,z_R,gone\n1,0,0,0,maybe\n", "{path}:2: gone: 'maybe' should be yes or no"),
        (
            "robot,x_R,y_R,z_R,undetermined\n1,0,0,0,zx\n",
            "{path}:2: undetermined: 'zx' should be x, ",
        ),
        ('robot,x_R,y_R,z_R\n"1,0,0,0\n', "{path}:2: not a row of a table: "),
        ('{"format": "tiswarm-sensing"}\n', "{path}:1: this is JSON, no table; give a table, such"),
    ],
)
def test_a_malformed_table_is_refused(tmp_path, text, problem):
    """The message names file, line and column, and says what to do."""
    path = tmp_path / "truth.csv"
    path.write_text(text)

    with pytest.raises(InputError) as refusal:
        read_positions(path)

    assert str(refusal.value).startswith(problem.format(path=path))


@pytest.fixture
def log():
    """A log of five robots."""
    log, _ = structure(Rule(), 5, 0)
    return replace(log, robot_id=np.array([40, 10, 50, 20, 30]))


def test_an_estimate_comes_back_in_join_order(log, tmp_path):
    """Rows may have any order; unknown standard deviations stay unknown."""
    path, empty = tmp_path / "estimate.csv", np.empty(0)
    known = Observability(
        cues=(), yaw_unknown=True, unknowns=16, gauge_yaw_sd=None, floppy_modes=1,
        floppy=np.arange(5) == 2, disconnected=np.arange(5) == 3,
    )  # fmt: skip
    estimate = Estimate(
        robot_id=log.robot_id, position=np.arange(15.0).reshape(5, 3),
        disconnected=known.disconnected, sd=np.array([0.0, 0.1, np.nan, 0.3, 0.4]),
        yaw=np.linspace(0.0, 1.0, 5),
        mirrored=np.arange(5) == 4, observability=known,
        iteration=empty, trace=empty, residual=empty,
    )  # fmt: skip
    write_estimate(path, estimate)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *sorted(rows)]))

    back = read_estimate(log, path)

    for name in ("robot_id", "position", "sd", "disconnected"):
        np.testing.assert_array_equal(getattr(back, name), getattr(estimate, name))
    np.testing.assert_allclose(back.yaw, estimate.yaw)
    assert back.known == ["yes", "yes", "floppy", "disconnected", "mirrored"]
    np.testing.assert_array_equal(read_positions_of(log, path), estimate.position)


@pytest.mark.parametrize(
    ("cells", "problem"),
    [
        ("7,0,0,0,yes", "robot: robot 7 is only here or only in the log"),
        (
            "10,0,0,0,perhaps",
            "csv:2: known: 'perhaps' should be yes, mirrored, floppy or disconnected",
        ),
    ],
)
def test_an_estimate_of_another_log_is_refused(log, tmp_path, cells, problem):
    """Robots and words must be those that the log and the method have."""
    path = tmp_path / "estimate.csv"
    rows = [f"{name},0,0,0,yes" for name in (20, 30, 40, 50)]
    path.write_text("\n".join(["robot,x_R,y_R,z_R,known", cells, *rows]))

    with pytest.raises(InputError, match=problem):
        read_estimate(log, path)


@pytest.mark.parametrize(
    "text",
    [
        "robot;x_R;y_R;z_R\n7;1;2;3\n",
        "robot\tx_R\ty_R\tz_R\n7\t1\t2\t3\n",
        "# of our camera\nrobot,x_R,y_R,z_R\n# first\n7,1,2,3\n",
    ],
)
def test_separators_and_comments_of_spreadsheets_are_read(tmp_path, text):
    """Spreadsheets of half of Europe write semicolons, many programs tabs and comments."""
    path = tmp_path / "truth.csv"
    path.write_text(text)

    robots, position, _ = read_positions(path)

    assert robots.tolist() == [7]
    assert position.tolist() == [[1.0, 2.0, 3.0]]


def test_a_mistake_below_comments_has_its_line(tmp_path):
    """Lines are counted in the file; a comma for thousands is named as the fault that it is."""
    path = tmp_path / "truth.csv"
    path.write_text("# made by hand\nrobot;x_R;y_R;z_R\n7;1,005.5;2;3\n")

    with pytest.raises(InputError, match=r":3: x_R: '1,005.5' is not a finite number up to "):
        read_positions(path)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read(tmp_path, separator):
    """In a column without decimal points, a comma in a number is the decimal one."""
    path = tmp_path / "truth.csv"
    rows = [["robot", "x_R", "y_R", "z_R"], ["7", "-1,5", "2,25e-1", "3"]]
    path.write_text("\n".join(separator.join(row) for row in rows))

    _, position, _ = read_positions(path)

    assert position.tolist() == [[-1.5, 0.225, 3.0]]


def test_decimal_commas_and_points_do_not_mix(tmp_path):
    """Beside 1.5, the number 1,005 may be a thousand and five."""
    path = tmp_path / "truth.csv"
    path.write_text("robot;x_R;y_R;z_R\n7;1,005;2;3\n8;1.5;2;3\n")

    with pytest.raises(InputError, match=r":2: x_R: '1,005' is not a finite number up to "):
        read_positions(path)
