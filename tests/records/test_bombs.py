"""Small files that would fill the memory when decompressed are refused, before they do."""

import resource
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from tiswarm.base.errors import InputError
from tiswarm.records import io
from tiswarm.records.positions import read_positions

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

SIZE = 3 * 2**30
"""Content of a bomb [byte]: more than the address space of the reader."""
SPACE = 2 * 2**30
MAGIC = b"\x89MCAP0\r\n"
READ = """
import sys
from pathlib import Path
from tiswarm.base.errors import InputError
from tiswarm.records.sensing_file import read_sensing_log
try:
    read_sensing_log(Path(sys.argv[1]))
except InputError as refusal:
    print(refusal)
"""


def _zstd() -> bytes:
    """Compress zeros, with their number in the head of the frame."""
    packer = zstd.ZstdCompressor()
    packer.set_pledged_input_size(SIZE)
    return b"".join(packer.compress(bytes(2**26)) for _ in range(SIZE // 2**26)) + packer.flush()


def _lz4() -> bytes:
    frame = pytest.importorskip("lz4.frame")
    packer = frame.LZ4FrameCompressor()
    pieces = [packer.begin(), *(packer.compress(bytes(2**26)) for _ in range(SIZE // 2**26))]
    return b"".join([*pieces, packer.flush()])


def _mcap(compression: str, stated: int, packed: bytes) -> bytes:
    """Write a file of one chunk that states the size of its content."""
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 0, stated, 0, len(name)) + name
    chunk = head + struct.pack("<Q", len(packed)) + packed
    return MAGIC + b"\x01" + struct.pack("<QII", 8, 0, 0) + b"\x06" + _sized(chunk)


def _sized(content: bytes) -> bytes:
    return struct.pack("<Q", len(content)) + content


def _refusal(path: Path) -> str:
    """Read a log in a process with little address space; returns what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE)),
        timeout=300,
    )
    assert done.stderr == ""
    return done.stdout.strip().removeprefix(str(path))


@pytest.mark.trial
@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (SIZE, ":1: a record or chunk has more than 256 MiB; write smaller ones, or copy it again"),
        (1000, ":1: not a whole MCAP file; record or copy it again"),
    ],
)
@pytest.mark.parametrize(("compression", "pack"), [("zstd", _zstd), ("lz4", _lz4)])
def test_a_chunk_is_never_inflated_beyond_what_it_states(compression, pack, stated, said, tmp_path):
    """A file of a hundred kilobytes took 8.5 GB: a chunk was decompressed as a whole."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(_mcap(compression, stated, pack()))

    assert _refusal(path) == said


@pytest.mark.parametrize("size", [2**40, 2**63])
def test_a_record_that_states_a_huge_size_is_not_made_room_for(size, tmp_path):
    """The size of a damaged record is any number of 64 bits."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + b"\x05" + struct.pack("<Q", size) + struct.pack("<HIQQ", 0, 0, 0, 0))

    assert _refusal(path).startswith(":1: ")


@pytest.mark.trial
def test_a_compressed_log_is_inflated_line_by_line(tmp_path):
    """The first line is longer than any line may be; no more of it is read."""
    path = tmp_path / "bomb.jsonl.zst"
    path.write_bytes(_zstd())

    assert _refusal(path) == ":1: the line is longer than 64 MiB; write one robot a line"


def test_a_compressed_table_has_a_bound(tmp_path, monkeypatch):
    """Its rows are all in memory, of which a compressed file gives no idea."""
    monkeypatch.setattr(io, "MAX_TABLE_BYTES", 2**20)
    path = tmp_path / "bomb.csv.zst"
    path.write_bytes(zstd.compress(b"robot,x_R,y_R,z_R\n" + b"1,0,0,0\n" * 2**18))

    with pytest.raises(InputError, match=r"has more than 1 MiB; decompress it if that is right"):
        read_positions(path)
