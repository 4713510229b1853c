"""A damaged cache of kernels costs time, never a crash."""

import fcntl
import shutil
import tempfile
from pathlib import Path

import pytest

from tiswarm.compute import backend, kernel_cache
from tiswarm.compute.lang import LIBRARY, ti


@pytest.fixture
def cache(tmp_path) -> Path:
    """A sealed cache of two files, one in a folder of its own, as quadrants stores kernels."""
    folder = tmp_path / "kernels" / "library-1.2.3"
    with kernel_cache.sealed(folder):
        (folder / "index").write_bytes(b"abc")
        (folder / "deeper").mkdir()
        (folder / "deeper" / "kernel").write_bytes(b"machine code")
    return folder


def _flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)


def _replace_by_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def test_a_sound_cache_is_kept(cache, capsys):
    """Kernels are compiled once."""
    with kernel_cache.sealed(cache):
        (cache / "another").write_bytes(b"more")
    with kernel_cache.sealed(cache):
        kept = {file.name for file in cache.iterdir()}

    assert {"index", "deeper", "another"} <= kept
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", ["index", "deeper/kernel", "seal"])
@pytest.mark.parametrize("damage", [_flip, Path.unlink, _replace_by_folder])
def test_any_damage_clears_the_cache(cache, capsys, name, damage):
    """The library would read or write it, and crash or hang; one line says what happened."""
    damage(cache / name)

    with kernel_cache.sealed(cache):
        assert not [file for file in cache.iterdir() if file.name != "seal"]

    [line] = capsys.readouterr().err.splitlines()
    assert line == (f"tiswarm: warning: {cache}: damaged kernel cache cleared; compiling again")
    assert [path.name for path in cache.parent.iterdir() if path.is_dir()] == [cache.name]


def test_what_a_killed_process_left_half_written_is_no_longer_read(cache):
    """It wrote no seal; a lock of the library would keep all later kernels from being stored."""
    (cache / "index.lock").touch()

    with kernel_cache.sealed(cache):
        assert not (cache / "index.lock").exists()


def test_one_process_writes_at_a_time(cache):
    """The seal would else miss what another one writes."""
    with (cache.parent / "library-1.2.3.lock").open("w") as lock:
        with kernel_cache.sealed(cache), pytest.raises(BlockingIOError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_clearing_says_whether_there_was_anything(cache):
    """A crash without any stored kernel has another cause."""
    assert kernel_cache.clear(cache)
    assert not kernel_cache.clear(cache)


def test_the_backend_starts_beside_damaged_kernels(tmp_path, monkeypatch, capsys):
    """It stores its kernels under a seal, and finds out what happened to them since."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("TI_OFFLINE_CACHE_FILE_PATH", raising=False)
    folder = Path(backend.start(threads=1, precision="f32").cache)
    backend.start(threads=1)
    stored = [file for file in folder.rglob("*") if file.is_file()]  # quadrants has a folder within
    backend.start(threads=1, precision="f32")
    before = capsys.readouterr().err
    for file in stored:
        _flip(file)

    backend.start(threads=1)

    assert folder.is_relative_to(tmp_path)
    assert len(stored) > 2
    assert before == ""
    assert "damaged kernel cache cleared" in capsys.readouterr().err


def test_kernels_outlast_a_reset_by_other_code(monkeypatch, capsys, tmp_path):
    """The library writes them on its order, too; they are sealed, not taken for damaged."""
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path))
    backend.start(threads=1, precision="f32")

    ti.reset()
    running = backend.start(threads=1, precision="f32")

    assert capsys.readouterr().err == (
        f"tiswarm: warning: a reset() of {LIBRARY} ended kernels; starting them anew\n"
    )
    assert not running.is_cold


def test_a_folder_that_another_process_has_just_put_aside_is_empty(cache, monkeypatch):
    """Locks may not reach other nodes."""
    make = tempfile.mkdtemp

    def make_later(**options):
        shutil.rmtree(cache)
        return make(**options)

    monkeypatch.setattr(tempfile, "mkdtemp", make_later)

    assert not kernel_cache.clear(cache)

    assert cache.is_dir()
