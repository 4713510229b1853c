"""A file that a user names as an output is replaced only if tiswarm wrote it, byte for byte."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.records import outputs

FOREIGN = "no tiswarm command wrote this file as it is"


@pytest.fixture
def path(tmp_path) -> Path:
    """An output that tiswarm wrote."""
    outputs.write(tmp_path / "estimate.csv", b"robot,x_R,y_R,z_R\n")
    return tmp_path / "estimate.csv"


def test_an_own_output_is_replaced_again_and_again(path):
    """A command may be repeated; its own output needs no option."""
    for content in (b"one", b"two", b"one"):
        outputs.write(path, content)

        assert path.read_bytes() == content
        assert outputs.is_own(path)


@pytest.mark.parametrize("content", [b"mine", b"", b"robot,x_R,y_R,z_R\n0,0,0,0\n"])
def test_a_file_of_somebody_else_is_refused_and_stays(tmp_path, content):
    """No header or format makes a file tiswarm's own; the remedy is an option."""
    mine = tmp_path / "mine.csv"
    mine.write_bytes(content)

    with pytest.raises(InputError, match=rf"mine.csv: {FOREIGN}; .*--overwrite"):
        outputs.write(mine, b"lost")
    assert mine.read_bytes() == content

    outputs.write(mine, b"new", overwrite=True)
    assert mine.read_bytes() == b"new"
    assert outputs.is_own(mine)


@pytest.mark.parametrize("change", [
    lambda path: path.write_bytes(path.read_bytes() + b"a note of mine\n"),
    lambda path: path.rename(path.with_name("other")) and shutil.copy(__file__, path),
    lambda path: path.with_name(outputs.LEDGER).unlink(),
    lambda path: path.with_name(outputs.LEDGER).write_bytes(b"mine"),
])  # fmt: skip
def test_what_was_edited_or_lost_its_ledger_is_refused(path, change):
    """A user who edited an output wants to keep the edit."""
    change(path)
    before = path.read_bytes()

    with pytest.raises(InputError, match=FOREIGN):
        outputs.write(path, b"lost")

    assert path.read_bytes() == before


def test_a_file_that_appears_meanwhile_stays(tmp_path):
    """A long command looks again before it replaces anything."""
    path = tmp_path / "late.csv"

    with pytest.raises(InputError, match=FOREIGN), outputs.opened(path) as file:
        file.write(b"%d lost" % path.write_bytes(b"mine"))

    assert path.read_bytes() == b"mine"
    assert [each.name for each in tmp_path.iterdir()] == ["late.csv"]


def test_a_copy_under_another_name_is_its_owners(path):
    """Somebody kept it."""
    kept = shutil.copy(path, path.with_name("kept.csv"))

    assert not outputs.is_own(kept)


@pytest.mark.parametrize("make", [
    lambda path, other: path.symlink_to(other),
    lambda path, other: path.symlink_to("nowhere"),
    lambda path, other: path.symlink_to(path.name),
    lambda path, other: path.mkdir(),
])  # fmt: skip
@pytest.mark.parametrize("overwrite", [True, False])
def test_no_link_or_folder_is_replaced(path, make, overwrite):
    """A link in a folder of somebody else may lead to any file of the user."""
    place, before = path.with_name("place"), path.read_bytes()
    make(place, path)

    with pytest.raises(InputError, match=r"place: this is a (link|folder); name "):
        outputs.write(place, b"lost", overwrite=overwrite)

    assert path.read_bytes() == before
    assert not place.is_file() or place.is_symlink()


@pytest.mark.parametrize("overwrite", [True, False])
def test_devices_and_pipes_are_refused(tmp_path, overwrite):
    """A temporary file would replace the device."""
    os.mkfifo(tmp_path / "fifo")

    for place in (Path("/dev/full"), Path("/dev/null"), tmp_path / "fifo"):
        with pytest.raises(EnvironmentTroubleError, match="this is no regular file"):
            outputs.check({"out": place}, overwrite=overwrite)


@pytest.mark.parametrize("name", ["same", "folder/../same", "link", "hard", "linked/same"])
def test_an_input_is_never_an_output(tmp_path, monkeypatch, name):
    """Neither another name, nor an earlier write by tiswarm, nor the option makes it an output."""
    monkeypatch.chdir(tmp_path)
    outputs.write(Path("same"), b"data")
    Path("folder").mkdir()
    Path("link").symlink_to("same")
    Path("hard").hardlink_to("same")
    Path("linked").symlink_to(".")

    for overwrite in (True, False):
        with pytest.raises(InputError, match="out: this is an input, which"):
            outputs.check({"out": Path(name)}, [None, "gone", "same"], overwrite=overwrite)
    with pytest.raises(InputError, match="out: this is an input, which"):
        outputs.check({"out": Path("same")}, [Path(name)], overwrite=True)


def test_files_of_an_input_folder_are_inputs_but_own_ones(tmp_path):
    """A run is exported into its folder, but never over its cases."""
    (tmp_path / "case.csv").write_bytes(b"sensed")
    outputs.write(tmp_path / "export.csv", b"again")

    outputs.check({"out": tmp_path / "export.csv"}, [tmp_path], overwrite=False)
    outputs.check({"out": tmp_path / "new.csv"}, [tmp_path], overwrite=False)
    with pytest.raises(InputError, match="this is an input"):
        outputs.check({"out": tmp_path / "case.csv"}, [tmp_path], overwrite=True)


def test_two_outputs_are_two_files(tmp_path):
    """One would replace the other in silence."""
    named = {"out": tmp_path / "a", "estimate": tmp_path / "." / "a", "report": None}

    with pytest.raises(InputError, match="estimate: out names the same file"):
        outputs.check(named, overwrite=True)


def test_an_open_output_is_no_open_input(tmp_path):
    """A log to which its own answers are appended would never end."""
    (tmp_path / "log").write_bytes(b"data")

    with (tmp_path / "log").open("rb") as read, (tmp_path / "log").open("ab") as written:
        for given in (read, tmp_path / "log"):
            with pytest.raises(InputError, match="the output is the input"):
                outputs.refuse_same(written, given)
        outputs.refuse_same(written, [])
    with Path(os.devnull).open("r+b") as null:
        outputs.refuse_same(null, null)


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    """One file of somebody else stops all."""
    (tmp_path / "b").write_bytes(b"mine")

    with pytest.raises(InputError, match=FOREIGN):
        outputs.write_folder(tmp_path, {"a": b"1", "b": b"2"}, overwrite=False)
    assert [each.name for each in tmp_path.iterdir()] == ["b"]
    with pytest.raises(InputError, match="a: out: its folder is a file; name a folder"):
        outputs.write_folder(tmp_path / "b", {"a": b"1"}, overwrite=True)

    written = outputs.write_folder(tmp_path, {"a": b"1", "b": b"2"}, overwrite=True)
    assert [each.read_bytes() for each in written] == [b"1", b"2"]
    assert [*map(outputs.is_own, written)] == [True, True]


def test_the_ledger_reads_as_sha256sum_writes_it(path):
    """A user can check the outputs of a folder; a line that a kill cut costs no other one."""
    ledger = path.with_name(outputs.LEDGER)
    with ledger.open("ab") as file:
        file.write(b"12ab")
    outputs.write(path.with_name("second"), b"2")

    command = ["sha256sum", "--check", outputs.LEDGER]
    done = subprocess.run(command, cwd=path.parent, capture_output=True, check=True)

    assert done.stdout == b"estimate.csv: OK\nsecond: OK\n"


@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_a_ledger_that_leads_elsewhere_is_not_written(tmp_path, link):
    """It would add lines to a file of the user."""
    (tmp_path / "diary").write_bytes(b"# SHA-256 of the files in this folder")
    link(tmp_path / outputs.LEDGER, tmp_path / "diary")
    before = (tmp_path / "diary").read_bytes()

    outputs.write(tmp_path / "a", b"1")

    assert (tmp_path / "diary").read_bytes() == before
    assert not outputs.is_own(tmp_path / "a")


def test_a_file_of_a_run_replaces_a_link_and_not_what_it_leads_to(path):
    """The folder of a run may come from anywhere."""
    link = path.with_name("errors.png")
    link.symlink_to(path)
    before = path.read_bytes()

    outputs.write_own(link, b"picture")

    assert path.read_bytes() == before
    assert outputs.is_own(link)


def test_a_folder_in_place_of_the_ledger_stays_closed(tmp_path):
    """A service that writes an output a second would soon have no descriptors left."""
    (tmp_path / outputs.LEDGER).mkdir()
    before = len([*Path("/dev/fd").iterdir()])

    for _ in range(3):
        outputs.write(tmp_path / "estimate.csv", b"1", overwrite=True)

    assert len([*Path("/dev/fd").iterdir()]) == before
