"""Logs and tables whose names end in .zst are compressed files with the same content."""

import sys
from dataclasses import fields

import numpy as np
import pytest

from tests.robustness.mutations import Random, damaged
from tests.runs import REPOSITORY
from tiswarm.app.inspection import inspect
from tiswarm.base.errors import InputError
from tiswarm.records import io
from tiswarm.records.positions import read_positions_of, write_positions
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

EXAMPLE = REPOSITORY / "scenarios" / "examples" / "fireant2d-log.jsonl"


@pytest.fixture
def packed(tmp_path):
    """The example, compressed."""
    path = tmp_path / "log.jsonl.zst"
    write_sensing_log(read_sensing_log(EXAMPLE), path)
    return path


def test_a_compressed_log_reads_back(packed):
    """Every array comes back, and a decompressor finds the plain file."""
    plain = packed.with_name("log.jsonl")
    log = read_sensing_log(EXAMPLE)
    write_sensing_log(log, plain)

    back = read_sensing_log(packed)

    assert zstd.decompress(packed.read_bytes()) == plain.read_bytes()
    for field in fields(log):
        if field.name not in {"noise", "stances"}:
            np.testing.assert_array_equal(getattr(back, field.name), getattr(log, field.name))
    assert back.noise == log.noise


def test_frames_of_a_log_may_follow_each_other(packed):
    """Parts of a log that were compressed apart are one log when put together."""
    lines = EXAMPLE.read_bytes().splitlines(keepends=True)
    packed.write_bytes(b"".join(map(zstd.compress, lines)))

    assert read_sensing_log(packed).robot_count == len(lines) - 1


def test_check_knows_the_name(packed):
    """A compressed log is not taken for a scenario."""
    assert inspect(packed).mistakes == ()
    assert inspect(packed).summary.startswith("3 robots")


def test_tables_are_compressed_too(packed):
    """Positions follow the same rule of names."""
    log, table = read_sensing_log(packed), packed.with_name("truth.csv.zst")
    position = np.arange(9.0).reshape(3, 3)

    write_positions(table, log.robot_id, position, length_unit=log.length_unit)

    assert zstd.decompress(table.read_bytes()).startswith(b"robot,x_mm")
    np.testing.assert_array_equal(read_positions_of(log, table), position)


def test_a_mistake_in_a_compressed_log_has_its_line(packed):
    """Lines are counted in the content."""
    header, anchor, *_ = EXAMPLE.read_bytes().splitlines(keepends=True)
    packed.write_bytes(zstd.compress(header + anchor + b"{}\n"))

    with pytest.raises(InputError, match=rf"^{packed}:3: robot, "):
        read_sensing_log(packed)


@pytest.mark.parametrize(
    ("cut", "problem"),
    [
        (lambda raw: raw[:-3], ": the compressed file ends in the middle; copy it again"),
        (lambda raw: raw[:2], ":1: the compressed file ends in the middle; copy it again"),
        (lambda raw: raw + b"and more", ": not a whole Zstandard file "),
        (lambda raw: raw[:-1] + bytes([raw[-1] ^ 1]), ": not a whole Zstandard file "),
        (lambda _: b"", ":1: the compressed file ends in the middle; copy it again"),
        (lambda _: EXAMPLE.read_bytes(), ":1: not a whole Zstandard file (Unknown frame descript"),
    ],
)
def test_a_damaged_compressed_log_is_refused_in_one_line(packed, cut, problem):
    """Cut files, foreign bytes and wrong checksums are mistakes of the file, with a line."""
    packed.write_bytes(cut(packed.read_bytes()))

    with pytest.raises(InputError) as refusal:
        read_sensing_log(packed)

    assert problem in str(refusal.value)
    assert str(refusal.value).startswith(f"{packed}:")


def test_random_damage_never_escapes(packed):
    """Each damaged file is refused in one line; its checksum reveals what still is valid text."""
    raw, random = packed.read_bytes(), Random(0)

    for _ in range(300):
        packed.write_bytes(damaged(random, raw))
        with pytest.raises(InputError) as refusal:
            read_sensing_log(packed)
        assert "\n" not in str(refusal.value)


def test_a_bomb_is_not_unpacked_whole(packed, monkeypatch):
    """A line of a compressed file has the same limit as any line."""
    monkeypatch.setattr(io, "MAX_LINE_BYTES", 1000)
    packed.write_bytes(zstd.compress(b" " * 10**8))

    with pytest.raises(InputError, match=":1: the line is longer than"):
        read_sensing_log(packed)
