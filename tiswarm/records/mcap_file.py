"""MCAP, a container of messages with times, as Foxglove and ROS 2 read it.

The topic `sensing` is a sensing log: its header, then a message for each robot, both as the lines
of `sensing.jsonl`. Times are join indices [s]. Specification: https://mcap.dev/spec.
"""

import io
import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from tiswarm.errors import EnvironmentTroubleError, InputError
from tiswarm.records.io import MAX_LINE_BYTES, decode, unreadable

SENSING = "sensing"
"""Topic of a sensing log."""
_NANOSECONDS = 10**9


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
            data, time = json.dumps(content, allow_nan=False).encode(), join * _NANOSECONDS
            writer.add_message(channel, time, data, time, number)
    writer.finish()
    return stream.getvalue()


def sensing_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield each message of the topic `sensing` with its number, counted from 1.

    Raises:
        InputError: the file cannot be read, is damaged or has no such message.
        EnvironmentTroubleError: the library mcap is not installed.
    """
    try:
        from mcap.exceptions import McapError  # noqa: PLC0415 - an extra
        from mcap.reader import make_reader  # noqa: PLC0415
        from zstandard import ZstdError  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise _missing_library() from error
    number = 0
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            for _, _, message in reader.iter_messages(topics=[SENSING], log_time_order=False):
                number += 1
                if len(message.data) > MAX_LINE_BYTES:
                    problem = "the message is longer than 64 MiB; write one robot a message"
                    raise InputError(problem, path=path, line=number)
                yield number, decode(message.data, path, number)
    except OSError as error:
        raise unreadable(path, error) from error
    except (McapError, ZstdError, struct.error, ValueError, RuntimeError, LookupError) as error:
        problem = "not a whole MCAP file; record or copy it again"
        raise InputError(problem, path=path, line=number + 1) from error
    if number == 0:
        problem = f"there are no messages of the topic {SENSING}; see tiswarm export --format mcap"
        raise InputError(problem, path=path, line=1)


def _missing_library() -> EnvironmentTroubleError:
    return EnvironmentTroubleError("MCAP needs the library mcap; pip install 'tiswarm[mcap]'")
