"""MCAP, a container of messages with times, as Foxglove and ROS 2 read it.

The topic `sensing` is a sensing log: its header, then a message for each robot, both as the lines
of `sensing.jsonl`. Times are join indices [s]. Specification: https://mcap.dev/spec.
"""

import io
import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.records.io import MAX_LINE_BYTES, open_input, unpacked, unreadable

SENSING = "sensing"
"""Topic of a sensing log."""
_NANOSECONDS = 10**9
_MAX_RECORD_BYTES = 2**28
"""Largest record or content of a chunk that is read [byte]; recorders write some MiB."""

_DAMAGE = (struct.error, ValueError, ArithmeticError, RuntimeError, LookupError)
"""What reading damaged bytes raises, besides the errors of the library."""


def encode_messages(topics: Mapping[str, Iterable[tuple[int, Mapping[str, Any]]]]) -> bytes:
    """Encode topics of (join index, content as JSON has it); equal topics give equal bytes.

    Raises:
        EnvironmentTroubleError: the library mcap is not installed.
    """
    try:
        from mcap.writer import Writer  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise _missing_library() from error
    stream = io.BytesIO()
    writer: Any = Writer(stream)  # in part without types
    writer.start(library="tiswarm")
    for topic, messages in topics.items():
        channel = writer.register_channel(topic, "json", schema_id=0)
        for number, (join, content) in enumerate(messages):
            data = json.dumps(content, allow_nan=False).encode()
            time = join * _NANOSECONDS
            writer.add_message(channel, time, data, time, number)
    writer.finish()
    return stream.getvalue()


def sensing_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the bytes of each message of the topic `sensing` with its number, counted from 1.

    Raises:
        InputError: the file cannot be read, is damaged or has no such message.
        EnvironmentTroubleError: the library mcap is not installed.
    """
    try:
        from mcap.exceptions import McapError  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise _missing_library() from error
    number = 0
    try:
        with open_input(path) as file:
            for data in _messages(file):
                number += 1
                if len(data) > MAX_LINE_BYTES:
                    problem = "the message is longer than 64 MiB; write one robot a message"
                    raise InputError(problem, path=path, line=number)
                yield number, data
    except _TooLargeError as error:
        problem = "a record or chunk has more than 256 MiB; write smaller ones, or copy it again"
        raise InputError(problem, path=path, line=number + 1) from error
    except OSError as error:
        raise unreadable(path, error) from error
    except (McapError, *_DAMAGE) as error:
        problem = "not a whole MCAP file; record or copy it again"
        raise InputError(problem, path=path, line=number + 1) from error
    if number == 0:
        problem = f"there are no messages of the topic {SENSING}; see tiswarm export --format mcap"
        raise InputError(problem, path=path, line=1)


def _messages(file: BinaryIO) -> Iterator[bytes]:
    """Yield the data of each message of the topic `sensing`; one chunk is in memory at a time."""
    from mcap.opcode import Opcode  # noqa: PLC0415 - an extra
    from mcap.records import Channel, Chunk, Message  # noqa: PLC0415
    from mcap.stream_reader import StreamReader, get_chunk_data_stream  # noqa: PLC0415

    def records() -> Iterator[object]:
        bounded: Any = _Bounded(file)
        for record in StreamReader(bounded, emit_chunks=True, validate_crcs=True).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            content = replace(record, compression="", data=_unpacked_chunk(record))
            stream, length = get_chunk_data_stream(content, validate_crc=True)
            while stream.count < length:
                opcode = stream.read1()
                size = stream.read8()
                if opcode == Opcode.MESSAGE:
                    yield Message.read(stream, size)
                elif opcode == Opcode.CHANNEL:
                    yield Channel.read(stream)
                else:
                    stream.read(size)

    topics: dict[int, str] = {}
    for record in records():
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and topics[record.channel_id] == SENSING:
            yield record.data


def _unpacked_chunk(chunk: Any) -> bytes:  # noqa: ANN401 - of an extra
    """Decompress a chunk, never beyond the size that it states."""
    size: int = chunk.uncompressed_size
    if size > _MAX_RECORD_BYTES:
        raise _TooLargeError
    if chunk.compression == "zstd":
        return unpacked(chunk.data, size)
    content: bytes = chunk.data
    if chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - comes with mcap

        content = LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression:
        raise ValueError("an unknown compression")
    if len(content) != size:
        raise ValueError("another size than stated")
    return content


class _TooLargeError(Exception):
    """A record, or the content of a chunk, is too large."""


class _Bounded:
    """A file that is never read in pieces of more than a record may have."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """Read at most `size` bytes."""
        if size > _MAX_RECORD_BYTES:
            raise _TooLargeError
        return self._file.read(size)


def _missing_library() -> EnvironmentTroubleError:
    return EnvironmentTroubleError("MCAP needs the library mcap; pip install 'tiswarm[mcap]'")
