"""Files appear whole or not at all."""

import pytest

from tiswarm.records.io import replacing, write_bytes, write_text


def test_text_is_written_as_it_is(tmp_path):
    """Line ends are not translated and the encoding is UTF-8."""
    path = tmp_path / "file"

    write_text(path, "ä\r\nb\n")

    assert path.read_bytes() == "ä\r\nb\n".encode()


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
