"""Files appear whole or not at all, and tables are read whole."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tiswarm.base.errors import InputError
from tiswarm.records import io
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.io import replacing, write_bytes

HERE = io._HOST  # noqa: SLF001 - as names of temporary files have it


def test_nothing_is_left_of_a_write_that_failed(tmp_path):
    """The old file stays, and no temporary file lies beside it."""
    path = tmp_path / "file"
    write_bytes(path, b"old")

    with pytest.raises(TypeError), replacing(path) as file:
        file.writelines([b"half of the ne", None])

    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_never_sees_a_part(tmp_path):
    """While the new file is written, its name still leads to the old one."""
    path = tmp_path / "file"
    write_bytes(path, b"old")

    with replacing(path) as file:
        file.write(b"new")
        during = path.read_bytes()

    assert during == b"old"
    assert path.read_bytes() == b"new"


@pytest.fixture(scope="module")
def ended():
    """Number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def temporary(path, monkeypatch, *, process=None, host=None):
    """Make a temporary file of a path, as a process of some machine would."""
    with monkeypatch.context() as patch:
        patch.setattr(io.os, "getpid", lambda: process or os.getppid())
        patch.setattr(io, "_HOST", host or HERE)
        made = io.path_for(path, "tmp")
    made.write_bytes(b"half of the ne")
    return made


def test_a_write_removes_what_killed_writers_left(tmp_path, monkeypatch, ended):
    """Kills of large writes would fill the disk with hidden files."""
    path = tmp_path / "file"
    for _ in range(3):
        temporary(path, monkeypatch, process=ended)

    write_bytes(path, b"new")

    assert [*tmp_path.iterdir()] == [path]
    assert path.read_bytes() == b"new"


def test_a_write_removes_no_file_of_others(tmp_path, monkeypatch, ended):
    """A live process still writes its file, and one of another machine may."""
    path = tmp_path / "file"
    kept = {
        temporary(path, monkeypatch),
        temporary(path, monkeypatch, process=os.getpid()),
        temporary(path, monkeypatch, process=ended, host="0123ab"),
        temporary(tmp_path / "file.csv", monkeypatch, process=ended),
        temporary(tmp_path / "fil", monkeypatch, process=ended),
    }
    for name in (".file.notes.tmp", f".file.{HERE}-{ended}.tmp"):
        (tmp_path / name).write_text("of the user")
        kept.add(tmp_path / name)
    aim = temporary(tmp_path / "aim", monkeypatch)
    link = temporary(path, monkeypatch, process=ended)
    link.unlink()
    link.symlink_to(aim)

    write_bytes(path, b"new")

    assert {*tmp_path.iterdir()} == {path, link, aim, *kept}


def test_a_wide_table_takes_further_columns(tmp_path, monkeypatch):
    """Each run warned of fragmented frames: pandas 3 reads each column apart."""
    path = tmp_path / "table.csv"
    columns = [f"c{n}" for n in range(150)]
    path.write_text(f"{','.join(columns)}\n{','.join(['0.5'] * 150)}\n")
    real = pd.read_csv

    def in_pieces(*arguments, **options):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            whole = real(*arguments, **options)
            apart = pd.DataFrame(index=whole.index)
            for name in whole:
                apart[name] = whole[name]
        return apart

    monkeypatch.setattr(pd, "read_csv", in_pieces)
    table = read_frame(path, numbers=columns)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table["further"] = 1.0
    assert table.shape == (1, 151)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=40))
def test_a_table_reads_back_to_the_same_bits(tmp_path, numbers):
    """No number of a run changes because a figure or a report read it from a table."""
    path = tmp_path / "table.csv"
    write_frame(pd.DataFrame({"x": numbers}), path)

    assert read_frame(path, numbers=["x"])["x"].astype(float).tolist() == numbers


def test_a_verdict_beside_an_empty_cell_is_a_number(tmp_path):
    """A condition whose cases all failed leaves gaps in a column of True and False."""
    path = tmp_path / "t.csv"
    path.write_text("x,converged\n1,True\n2,\n3,False\n")

    table = read_frame(path, numbers_after="x")

    assert pd.api.types.is_float_dtype(table["converged"])
    assert table["converged"].fillna(-1.0).tolist() == [1.0, -1.0, 0.0]


def test_a_folder_named_as_the_home_is_another(tmp_path, monkeypatch):
    """A shell makes ~ the home of the user; a program reads the folder that was named."""
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    Path("~").mkdir()
    write_frame(pd.DataFrame({"x": [1.0]}), Path("~/t.csv"))
    write_frame(pd.DataFrame({"x": [2.0]}), tmp_path / "home" / "t.csv")

    assert read_frame(Path("~/t.csv"), numbers=["x"])["x"].tolist() == [1.0]


@pytest.mark.parametrize(
    "cell", ["1e4001234567", "-1e4001234567", "1e400", "1_0", "inf", "1e13", "x", "", "True"]
)
def test_a_cell_that_is_no_number_is_refused(tmp_path, cell):
    """Of long exponents, pandas reads another memory than the table's, and ends the process."""
    (tmp_path / "t.csv").write_text(f"x,y\n1.0,\n{cell},1\n")

    with pytest.raises(InputError, match=r"t.csv:3: x: .+ is not a number up to 1e\+12"):
        read_frame(tmp_path / "t.csv", numbers=["x"])


@pytest.mark.parametrize(
    "name", ["x" * 255, "\u00e9" * 127, "\u6f22" * 85], ids=["ascii", "latin", "han"]
)
def test_a_name_as_long_as_file_systems_allow_is_written(tmp_path, name):
    """They count bytes, and letters beyond ASCII have several."""
    write_bytes(tmp_path / name, b"1")

    assert [path.name for path in tmp_path.iterdir()] == [name]
