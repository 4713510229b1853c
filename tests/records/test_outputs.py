"""No output replaces a file that exists, unless the user says so, and none replaces an input."""

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from tiswarm.base.errors import EnvironmentTroubleError, InputError, OutputExistsError
from tiswarm.records.outputs import NEW, Outputs, refuse_same

OVERWRITE = Outputs(overwrite=True)
BOTH = pytest.mark.parametrize("outputs", [NEW, OVERWRITE], ids=["new", "overwrite"])


@pytest.fixture
def path(tmp_path) -> Path:
    """A file that exists."""
    file = tmp_path / "estimate.csv"
    file.write_bytes(b"robot,x_R,y_R,z_R\n")
    return file


@pytest.fixture(params=["links", "no links"])
def links(request, monkeypatch) -> bool:
    """Whether the file system has hard links."""

    def link(*_):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    if request.param == "no links":
        monkeypatch.setattr(os, "link", link)
    return request.param == "links"


def _write(outputs: Outputs, path: Path, meanwhile: Callable[[], object]) -> None:
    """Write an output while something else happens."""
    with outputs.opened(path) as file:
        file.write(b"lost")
        meanwhile()


@pytest.mark.usefixtures("links")
def test_a_file_that_exists_stays(path):
    """Neither its format nor that tiswarm wrote it makes it less valuable."""
    before = path.read_bytes()

    with pytest.raises(
        OutputExistsError, match=r"estimate\.csv: exists already; give overwrite=True"
    ):
        NEW.write(path, b"lost")

    assert path.read_bytes() == before
    assert [*path.parent.iterdir()] == [path]


@pytest.mark.usefixtures("links")
@BOTH
def test_a_new_file_is_written_whole(tmp_path, outputs):
    """It has one name, and no temporary file remains."""
    path = tmp_path / "new.csv"

    outputs.write(path, b"whole")

    assert path.read_bytes() == b"whole"
    assert path.stat().st_nlink == 1
    assert [*tmp_path.iterdir()] == [path]


def test_a_file_is_replaced_if_the_user_says_so(path):
    """A hard link to the old file keeps what it has."""
    kept = path.with_name("kept.csv")
    kept.hardlink_to(path)

    OVERWRITE.write(path, b"new")

    assert path.read_bytes() == b"new"
    assert kept.read_bytes() == b"robot,x_R,y_R,z_R\n"


def test_the_error_names_every_file_and_option():
    """The user sees what `--overwrite` would replace, in one line."""
    folder = Path("imported")
    names = [f"{number}.csv" for number in range(20)]
    error = OutputExistsError({folder / "truth.csv": "out", Path("view.html"): "report"})
    many = OutputExistsError(dict.fromkeys([folder / name for name in names], "out"))

    assert str(error) == (
        "imported/truth.csv: exists already, as does view.html; "
        "give overwrite=True or another out and another report"
    )
    assert str(error.as_option()) == (
        "imported/truth.csv: exists already, as does view.html; "
        "give --overwrite or another --out and another --report"
    )
    assert ", as do 1.csv, 2.csv, " in str(many)
    assert ", 9.csv and 10 more; give overwrite=True or another out" in str(many)


@pytest.mark.usefixtures("links")
@pytest.mark.parametrize("make", [
    lambda path: path.write_bytes(b"mine"),
    lambda path: path.symlink_to("nowhere"),
    lambda path: path.mkdir(),
])  # fmt: skip
def test_a_file_that_appears_meanwhile_stays(tmp_path, make):
    """A long command looks again before it takes the name."""
    path = tmp_path / "late.csv"

    with pytest.raises(InputError, match=r"late\.csv: "):
        _write(NEW, path, lambda: make(path))

    assert not path.is_file() or path.read_bytes() == b"mine"
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.usefixtures("links")
def test_a_file_that_appears_at_the_last_moment_stays(tmp_path, monkeypatch):
    """Between the last look and the new name, another program may write a file."""
    path = tmp_path / "late.csv"

    def meanwhile() -> None:
        monkeypatch.setattr(Outputs, "_refuse", lambda *_: path.write_bytes(b"mine"))

    with pytest.raises(OutputExistsError, match=r"late\.csv: exists already"):
        _write(NEW, path, meanwhile)

    assert path.read_bytes() == b"mine"
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.usefixtures("links")
def test_of_many_writers_one_is_first(tmp_path):
    """The file is that of one writer, and all others are refused."""
    path, writers = tmp_path / "changes.jsonl", 8
    start, ends = threading.Barrier(writers), []

    def write(number: int) -> None:
        try:
            with NEW.opened(path) as file:
                file.write(b"%d" % number)
                start.wait()
        except OutputExistsError:
            ends.append("refused")
        else:
            ends.append(number)

    threads = [threading.Thread(target=write, args=[number]) for number in range(writers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    [first] = [end for end in ends if end != "refused"]
    assert len(ends) == writers
    assert path.read_bytes() == b"%d" % first
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("name", ["estimate.csv", "new.csv"])
def test_a_failed_write_leaves_the_folder_as_it_was(path, name):
    """An exception in the middle costs no byte."""
    before = path.read_bytes()

    with pytest.raises(ZeroDivisionError):
        _write(OVERWRITE, path.with_name(name), lambda: 1 / 0)

    assert path.read_bytes() == before
    assert [*path.parent.iterdir()] == [path]


@pytest.mark.parametrize("make", [
    lambda path, file: path.symlink_to(file),
    lambda path, file: path.symlink_to("nowhere"),
    lambda path, file: path.symlink_to(path.name),
    lambda path, file: path.mkdir(),
])  # fmt: skip
@BOTH
def test_no_link_or_folder_is_replaced(path, make, outputs):
    """A link in a folder of somebody else may lead to any file of the user."""
    place, before = path.with_name("place"), path.read_bytes()
    make(place, path)

    with pytest.raises(InputError, match=r"place: this is a (link|folder); name "):
        outputs.write(place, b"lost")

    assert path.read_bytes() == before
    assert not place.is_file() or place.is_symlink()


@BOTH
def test_devices_and_pipes_are_refused(tmp_path, outputs):
    """A temporary file would replace the device."""
    os.mkfifo(tmp_path / "fifo")

    for place in (Path("/dev/full"), Path("/dev/null"), tmp_path / "fifo"):
        with pytest.raises(EnvironmentTroubleError, match="this is no regular file"):
            outputs.check({"out": place})


@pytest.mark.parametrize("name", ["same", "folder/../same", "link", "hard", "linked/same"])
@pytest.mark.parametrize("overwrite", [True, False])
def test_an_input_is_never_an_output(tmp_path, monkeypatch, name, overwrite):
    """No other name makes it an output, nor does the option."""
    monkeypatch.chdir(tmp_path)
    Path("same").write_bytes(b"data")
    Path("folder").mkdir()
    Path("link").symlink_to("same")
    Path("hard").hardlink_to("same")
    Path("linked").symlink_to(".")
    of_file = Outputs(inputs=[None, "gone", "same"], overwrite=overwrite)
    of_name = Outputs(inputs=[Path(name)], overwrite=overwrite)

    with pytest.raises(InputError, match="out: this is an input, which"):
        of_file.check({"out": Path(name)})
    with pytest.raises(InputError, match="out: this is an input, which"):
        of_name.check({"out": Path("same")})
    with pytest.raises(InputError, match="this is an input, which"):
        of_file.write(Path(name), b"lost")

    assert Path("same").read_bytes() == b"data"


def test_files_of_an_input_folder_are_inputs(tmp_path):
    """A run is exported into its folder, but never over its cases."""
    (tmp_path / "case.csv").write_bytes(b"sensed")
    outputs = Outputs(inputs=[tmp_path], overwrite=True)

    outputs.check({"out": tmp_path / "new.csv"})
    with pytest.raises(InputError, match="this is an input"):
        outputs.check({"out": tmp_path / "case.csv"})


def test_two_outputs_are_two_files(tmp_path):
    """One would replace the other in silence."""
    named = {"out": tmp_path / "a", "estimate": tmp_path / "." / "a", "report": None}

    with pytest.raises(InputError, match="estimate: out names the same file"):
        OVERWRITE.check(named)


def test_an_open_output_is_no_open_input(tmp_path):
    """A log to which its own answers are appended would never end."""
    (tmp_path / "log").write_bytes(b"data")

    with (tmp_path / "log").open("rb") as read, (tmp_path / "log").open("ab") as written:
        for source in (read, tmp_path / "log"):
            with pytest.raises(InputError, match="the output is the input"):
                refuse_same(written, source)
        refuse_same(written, [])
    with Path(os.devnull).open("r+b") as null:
        refuse_same(null, null)


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    """One file that exists stops all."""
    files = {"a": b"1", "b": b"2"}
    (tmp_path / "b").write_bytes(b"mine")

    with pytest.raises(OutputExistsError, match="b: exists already"):
        NEW.write_folder(tmp_path, files)
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
    with pytest.raises(InputError, match="a: out: its folder is a file; name a folder"):
        OVERWRITE.write_folder(tmp_path / "b", {"a": b"1"})

    written = OVERWRITE.write_folder(tmp_path, files)

    assert [path.read_bytes() for path in written] == [b"1", b"2"]


def test_an_old_list_of_outputs_is_a_file_like_any_other(path):
    """Earlier versions kept `.tiswarm-outputs`; it neither frees a file nor is it changed."""
    ledger = path.with_name(".tiswarm-outputs")
    ledger.write_bytes(b"# SHA-256 of the files in this folder that tiswarm wrote\n")

    with pytest.raises(OutputExistsError, match="exists already"):
        NEW.write(path, b"lost")
    with pytest.raises(OutputExistsError, match="exists already"):
        NEW.write(ledger, b"lost")

    assert ledger.read_bytes().startswith(b"# SHA-256")
