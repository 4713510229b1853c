"""Files of users: any line ends, no pipe that blocks, no name that takes minutes to understand."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from tiswarm.api import open_swarms
from tiswarm.app.logs import open_log
from tiswarm.base.errors import InputError
from tiswarm.base.plugins import load_plugins
from tiswarm.formats.colors import read_colorings
from tiswarm.formats.imports import convert
from tiswarm.formats.poses import Poses, read_contacts, read_dock_offsets
from tiswarm.records.io import LONGEST_NAME, raw_lines
from tiswarm.records.positions import read_length_unit, read_positions
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe

POSES = "robot,x,y,z,qw,qx,qy,qz\n0,0,0,1.5,1,0,0,0\n1,3.1,0,1.5,1,0,0,0\n"
PLACES = "robot,x_R,y_R,z_R\n0,0,0,1\n1,2,0,1\n"
RANGES = "tag,beacon,range [m]\n" + "".join(
    f"T1,A{beacon},{length}\n" for length in (2.0, 2.1, 1.9, 2.05) for beacon in range(4)
)
BEACONS = "beacon,x [m],y [m],z [m]\nA0,0,0,0\nA1,3,0,0\nA2,0,3,0\nA3,0,0,3\n"


def two_robots():
    """Poses to which a table of contacts belongs."""
    return Poses(
        robot_id=np.array([0, 1]),
        position=np.zeros((2, 3)),
        orientation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        join=None,
        dock_offset_body=np.eye(3),
        length_unit="R",
    )


def ranges(path):
    """Import ranges, whose beacons have a file beside."""
    (path.parent / "beacons.csv").write_text(BEACONS)
    return convert(path, {"beacons": path.parent / "beacons.csv", "range_sd": 0.1})


def beacons(path):
    """Import beacons, whose ranges have a file beside."""
    (path.parent / "ranges.csv").write_text(RANGES)
    return convert(path.parent / "ranges.csv", {"beacons": path, "range_sd": 0.1})


TABLES = {
    "poses": (POSES, lambda path: convert(path, {"dock_radius": 1.0})),
    "positions": (PLACES, read_positions),
    "unit": (PLACES, read_length_unit),
    "colors": (
        "robot,charge\n0,1.5\n1,2.5\n",
        lambda path: read_colorings(f"{path}:charge", np.arange(2)),
    ),
    "docks": ("dock,x,y,z\n0,1,0,0\n1,0,1,0\n", read_dock_offsets),
    "contacts": (
        "robot,dock,other,other_dock\n0,1,1,2\n", lambda path: read_contacts(path, two_robots()),
    ),
    "ranges": (RANGES, ranges),
    "beacons": (BEACONS, beacons),
}  # fmt: skip
"""By what a table has: a small one, and its reader."""


def as_text(value):
    """Write results, so that arrays within tuples and records can be compared."""
    return repr(value)


@pytest.mark.parametrize("end", ["\r", "\r\n", "\r\r\n"], ids=["Mac", "Windows", "doubled"])
@pytest.mark.parametrize("name", TABLES)
def test_a_table_has_any_line_ends(name, end, tmp_path):
    """Excel for Mac saved carriage returns alone for twenty years."""
    text, read = TABLES[name]
    path = tmp_path / "t.csv"
    path.write_text(text)
    expected = as_text(read(path))
    path.write_text(text.replace("\n", end), newline="")

    assert as_text(read(path)) == expected


@pytest.mark.parametrize("end", [b"\r", b"\r\n", b"\r\r\n"], ids=["Mac", "Windows", "doubled"])
def test_a_log_has_any_line_ends(end, towers, tmp_path):
    """An editor that changes them changes no measurement."""
    path, other = tmp_path / "sensing.jsonl", tmp_path / "other.jsonl"
    write_sensing_log(observe(towers[0], SensingParams()), path)
    other.write_bytes(path.read_bytes().replace(b"\n", end))

    read = read_sensing_log(other)

    write_sensing_log(read, other)
    assert other.read_bytes() == path.read_bytes()


def test_lines_keep_their_numbers(tmp_path):
    """A message names the line that an editor shows."""
    path = tmp_path / "t.csv"
    path.write_bytes(b"a\rb\r\rc\r\nd\n\ne\r\r\nf")

    lines = [(number, raw.strip()) for number, raw in raw_lines(path)]

    assert lines == [*enumerate([b"a", b"b", b"", b"c", b"d", b"", b"e", b"f"], start=1)]


LOGS = {
    "log": ("log.jsonl", open_log),
    "compressed log": ("log.jsonl.zst", open_log),
    "log in MCAP": ("log.mcap", open_log),
    "scenario": ("s.yaml", load_scenario),
    "structures": ("s.npz", open_swarms),
    "trajectories": ("t.gsd", lambda path: convert(path, {})),
    "bag": ("t.bag", lambda path: convert(path, {})),
    "folder": ("folder/0.tum", lambda path: convert(path.parent, {})),
    "plug-in": ("own.py", lambda path: load_plugins([path])),
}
READERS = {name: ("t.csv", read) for name, (_, read) in TABLES.items() if name != "colors"} | LOGS


@pytest.fixture
def _impatient():
    """End a test that waits for a pipe."""

    def give_up(*_):
        pytest.fail("waits for ever")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("_impatient")
@pytest.mark.parametrize("name", READERS)
def test_a_pipe_with_a_name_is_refused(name, tmp_path):
    """To open one that nobody writes to waits for ever."""
    file, read = READERS[name]
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)

    with pytest.raises(InputError, match="is a pipe or a device; write its content to a file"):
        read(path)


@pytest.mark.parametrize("name", READERS)
def test_a_device_is_refused(name, tmp_path):
    """Zeros would fill the memory."""
    file, read = READERS[name]
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    path.symlink_to("/dev/zero")

    with pytest.raises(InputError, match="is a pipe or a device; write its content to a file"):
        read(path)


def test_a_log_comes_through_a_pipe_of_the_shell(towers, tmp_path):
    """`tiswarm localize <(xzcat log.jsonl.xz)` needs no file in between."""
    path = tmp_path / "sensing.jsonl"
    write_sensing_log(observe(towers[0], SensingParams()), path)
    content = path.read_bytes()
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receiver)
        with os.fdopen(sender, "wb") as pipe:
            pipe.write(content)
        os._exit(0)
    os.close(sender)

    read = read_sensing_log(Path(f"/dev/fd/{receiver}"))

    os.close(receiver)
    os.waitpid(child, 0)
    write_sensing_log(read, path)
    assert path.read_bytes() == content


@pytest.mark.parametrize("name", ["a\0b", "folder/a\0.yaml"])
@pytest.mark.parametrize(
    "read", [load_scenario, open_log, open_swarms, lambda path: convert(path, {})],
    ids=["scenario", "log", "structures", "poses"],
)  # fmt: skip
def test_a_path_with_a_nul_is_refused(read, name):
    """No shell can give one, but a script that reads names from a damaged file can."""
    with pytest.raises(InputError, match=r"NUL|no path of a file|neither a file nor"):
        read(Path(name))


LONG = {
    "brackets": "(" * 4000,
    "square brackets": "[" * 4000,
    "lines below": "_" * 4000,
    "letters": "x" * 4000,
    "spaces within": f"x{' ' * 4000}y",
    "NUL": "\0" * 4000,
    "bell": "x\a",
}
PARSED = ["poses", "positions", "colors", "docks", "contacts", "ranges", "beacons"]


@pytest.mark.parametrize("what", LONG)
@pytest.mark.parametrize("name", PARSED)
def test_a_damaged_name_of_a_column_is_refused(name, what, tmp_path):
    """Four thousand brackets took 6 s to understand, a hundred thousand NUL took minutes."""
    text, read = TABLES[name]
    head, *rows = text.splitlines()
    path = tmp_path / "t.csv"
    path.write_text("\n".join([f"{head},{LONG[what]}", *(f"{row},0" for row in rows)]) + "\n")

    with pytest.raises(InputError, match=r"t\.csv:1: (?:the name of column \d has|has NUL)"):
        read(path)


@pytest.mark.parametrize("name", PARSED)
def test_a_file_of_nul_is_refused(name, tmp_path):
    """A file system may leave one after a power cut."""
    path = tmp_path / "t.csv"
    path.write_bytes(b"\0" * 100_000)

    with pytest.raises(InputError, match=r"t\.csv:1: has NUL characters, as files after a power"):
        TABLES[name][1](path)


def test_the_longest_name_of_a_column_is_read(tmp_path):
    """Exports name columns by whole paths of a scene."""
    path = tmp_path / "t.csv"
    head, *rows = POSES.splitlines()
    name = "n" * LONGEST_NAME
    path.write_text("\n".join([f"{head},{name}", *(f"{row},0" for row in rows)]))

    found = convert(path, {"dock_radius": 1.0})[""]

    assert found.log.robot_count == 2


@pytest.mark.parametrize("row", ['"1,0,0,0', '"1"x,0,0,0', '"1\r",0,0,0"x'])
def test_a_damaged_row_is_refused_in_words_of_ours(row, tmp_path):
    """Python's reader of tables speaks to programmers."""
    path = tmp_path / "t.csv"
    path.write_text(f"robot,x_R,y_R,z_R\n{row}\n", newline="")

    with pytest.raises(InputError, match=r":2: not a row of a table: a quote has no end, or text"):
        read_positions(path)
