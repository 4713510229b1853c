"""A stream of lines is answered line by line, and the same lines get the same answers."""

import io
import json
import os
import threading

import pytest

from tests.localization.online.test_online import lines_of
from tests.structures import NOISY
from tiswarm import track
from tiswarm.base.errors import InputError, ResultWarning
from tiswarm.records import io as record_io
from tiswarm.sensing import observe

SET = {"anneal_growth": 0.5, "chains": 1, "steps": 20, "hold_steps": 5}


@pytest.fixture(scope="module")
def stream(towers):
    """Lines of a small tower with events, three of them wrong, as bytes."""
    header, *lines = lines_of(observe(towers[1], NOISY))[:10]
    robots = [json.loads(line) for line in lines]
    events = [
        {"event": "release", "robot": 5, "contacts": robots[5]["contacts"][:1]},
        {"event": "leave", "robot": 4},
        {"event": "leave", "robot": 4},
        {**robots[6], "event": "replace", "stances": robots[6]["stances"][1:]},
    ]
    header = json.dumps({**json.loads(header), "version": 3})
    last, lines = lines[8], [header, *lines[:3], "{", *lines[3:7], lines[6], lines[7]]
    return [line.encode() for line in [*lines, *map(json.dumps, events), last]]


@pytest.fixture(scope="module")
def answers(stream):
    """Answers of these lines."""
    found = io.StringIO()
    with pytest.warns(ResultWarning):
        track(as_input(stream), out=found, **SET)
    return found.getvalue().splitlines(keepends=True)


def as_input(lines):
    """Make an open input of lines."""
    return io.BytesIO(b"".join(line + b"\n" for line in lines))


def test_every_line_has_an_answer_and_broken_ones_are_skipped(stream, answers):
    """A refusal names the line; those after it count as if it had not been there."""
    found, clean = [json.loads(answer) for answer in answers], io.StringIO()
    kept = [line for k, line in enumerate(stream) if k not in {4, 9, 13}]

    with pytest.warns(ResultWarning) as warnings:
        track(as_input(stream[:6]), **SET)
    track(as_input(kept), out=clean, **SET)

    assert [answer["line"] for answer in found] == list(range(1, len(stream) + 1))
    assert [answer["line"] for answer in found if "refused" in answer] == [5, 10, 14]
    assert found[9]["refused"].startswith("robot: robot 6 has a line already")
    assert found[13]["refused"].startswith("robot: robot 4 has left")
    assert found[-1]["robots"] == 9
    assert found[-1]["moved"][-1]["robot"] == 8
    assert found[-1]["moved"][-1]["moved"] is None
    (warning,) = warnings
    assert str(warning.message).startswith("-:5: not JSON at column 2")
    assert str(warning.message).endswith("; skipped")
    moved = [json.loads(answer).get("moved") for answer in clean.getvalue().splitlines()]
    assert [answer.get("moved") for answer in found if "refused" not in answer] == moved


def test_lines_that_are_missing_at_the_end_are_reported(stream):
    """All lines that came have answers; a warning says that the header states more."""
    header, *robots = stream[:4]
    stated = json.dumps({**json.loads(header), "lines": 5}).encode()

    with pytest.warns(ResultWarning, match="^-:1: lines: 5 lines should follow, and 3 do; "):
        tracker = track(as_input([stated, *robots]), **SET)

    assert len(tracker.names) == 3


def test_a_file_of_answers_has_the_bytes_that_a_stream_has(tmp_path, stream, answers):
    """It appears whole, in place of an earlier one if asked to; a byte-order mark is no mistake."""
    source, out = tmp_path / "log.jsonl.zst", tmp_path / "changes.jsonl"
    with record_io.replacing(source) as file:
        file.write(b"\xef\xbb\xbf" + b"\r\n".join(stream))

    for overwrite in (False, True):
        with pytest.warns(ResultWarning):
            track(source, out=out, overwrite=overwrite, **SET)

        assert out.read_text() == "".join(answers)


def test_a_line_that_is_still_being_written_is_waited_for(stream, answers):
    """A part of a line is no line; at the end of the input the last line needs no newline."""
    reading, writing = os.pipe()
    parts, two = [], threading.Event()

    class Output(io.StringIO):
        def flush(self):
            if self.getvalue().count("\n") == 2:
                two.set()

    def feed():
        with os.fdopen(writing, "wb", buffering=0) as lines:
            lines.write(b"\n".join(stream[:3])[:-9])  # two lines, and part of the third one
            parts.append((two.wait(60), found.getvalue().count("\n")))
            lines.write(b"\n".join(stream[:3])[-9:])

    found = Output()
    feeding = threading.Thread(target=feed)
    feeding.start()
    with os.fdopen(reading, "rb") as lines:
        track(lines, out=found, **SET)
    feeding.join()

    assert parts == [(True, 2)]
    assert found.getvalue() == "".join(answers[:3])


def test_a_line_without_end_is_refused_at_the_limit(monkeypatch, stream):
    """A pipe of zeros would fill the memory."""
    monkeypatch.setattr(record_io, "MAX_LINE_BYTES", 100_000)
    endless = as_input([*stream[:2], b"\0" * 10**6])

    with pytest.raises(InputError, match=r"^-:3: the line is longer than .*; write one robot a li"):
        track(endless, **SET)

    assert endless.tell() < 300_000


def test_a_stream_without_a_header_is_refused():
    """Without it no line has a meaning."""
    with pytest.raises(InputError, match="-:1: the input is empty"):
        track(as_input([]))
    with pytest.raises(InputError, match="-:1: format: the first line is not a header"):
        track(as_input([b"{}"]))
