"""A stream of lines is answered line by line, and goes on where it was after it was stopped."""

import io
import json
import signal
import subprocess
import sys
import time

import pytest

from tests.localization.test_online import lines_of
from tests.runs import environment
from tests.structures import NOISY
from tiswarm.base.errors import InputError
from tiswarm.localization.online.stream import follow
from tiswarm.localization.params import OnlineParams
from tiswarm.sensing import observe

QUICK = OnlineParams(anneal_growth=0.5, chains=1, steps=20, hold_steps=5)
SET = ["--set", "anneal_growth=0.5", "--set", "chains=1", "--set", "steps=20"]


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


def track(folder, source, refused=None, resumed=None):
    """Track a stream with the output and the journal in a folder; return the output."""
    folder.mkdir(exist_ok=True)
    out = folder / "changes.jsonl"
    follow(
        source, out, folder / "journal", params=QUICK,
        on_refused=([] if refused is None else refused).append,
        on_resumed=([] if resumed is None else resumed).append,
    )  # fmt: skip
    return out.read_bytes()


def as_input(lines):
    """Make an open input of lines."""
    return io.BytesIO(b"".join(line + b"\n" for line in lines))


def test_every_line_has_an_answer_and_broken_ones_are_skipped(tmp_path, stream):
    """A refusal names the line; those after it count as if it had not been there."""
    refused = []

    answers = [json.loads(line) for line in track(tmp_path, as_input(stream), refused).splitlines()]

    assert [answer["line"] for answer in answers] == list(range(1, len(stream) + 1))
    assert [answer["line"] for answer in answers if "refused" in answer] == [5, 10, 14]
    assert refused[0].startswith("-:5: not JSON at column 2")
    assert refused[1].startswith("-:10: robot: robot 6 has a line already")
    assert refused[2].startswith("-:14: robot: robot 4 has left")
    assert all(line.endswith("; skipped") for line in refused)
    assert answers[-1]["robots"] == 9
    assert answers[-1]["moved"][-1]["robot"] == 8
    assert answers[-1]["moved"][-1]["moved"] is None
    kept = [line for k, line in enumerate(stream) if k not in {4, 9, 13}]
    clean = track(tmp_path / "clean", as_input(kept)).splitlines()
    moved = [json.loads(line).get("moved") for line in clean]
    assert [answer.get("moved") for answer in answers if "refused" not in answer] == moved


@pytest.mark.parametrize("from_file", [True, False])
def test_a_stream_cut_anywhere_goes_on_to_the_same_bytes(tmp_path, stream, from_file):
    """A line is in the journal before it is answered; a kill leaves either file cut anywhere."""
    source = tmp_path / "log.jsonl"
    source.write_bytes(b"".join(line + b"\n" for line in stream))
    whole = track(tmp_path / "whole", source)
    journal = (tmp_path / "whole" / "journal").read_bytes()
    ends = [0, *(k + 1 for k, byte in enumerate(journal) if byte == ord("\n"))]
    answered = [0, *(k + 1 for k, byte in enumerate(whole) if byte == ord("\n"))]
    cuts = [(ends[n] - 3, answered[n - 1]) for n in (1, 4, 6)]
    cuts += [(ends[n], answered[n - 1] + 5) for n in (1, 5, 9)]
    cuts += [(ends[n], answered[n]) for n in (3, len(stream))]

    for place, (lines, answers) in enumerate(cuts):
        folder = tmp_path / str(place)
        folder.mkdir()
        (folder / "journal").write_bytes(journal[:lines])
        (folder / "changes.jsonl").write_bytes(whole[:answers])
        taken = journal[:lines].count(b"\n")
        resumed = []
        again = track(folder, source if from_file else as_input(stream[taken:]), resumed=resumed)

        assert again == whole
        assert (folder / "journal").read_bytes() == journal
        assert resumed == ([taken + 1] if taken else [])


def test_another_input_than_the_journal_is_refused(tmp_path, stream):
    """Its answers would be about other robots."""
    source = tmp_path / "log.jsonl"
    source.write_bytes(b"\n".join(stream[:3]))
    track(tmp_path / "run", source)
    source.write_bytes(b"\n".join([stream[0], stream[2]]))

    with pytest.raises(InputError, match=r"log.jsonl:2: differs from .*journal; delete that"):
        track(tmp_path / "run", source)
    (tmp_path / "run" / "journal").unlink()
    with pytest.raises(InputError, match=r"changes.jsonl: answers more lines than"):
        track(tmp_path / "run", source)


def test_a_stream_without_a_header_is_refused(tmp_path):
    """Without it no line has a meaning."""
    with pytest.raises(InputError, match="-:1: the input is empty"):
        track(tmp_path / "empty", as_input([]))
    with pytest.raises(InputError, match="-:1: format: the first line is not a header"):
        track(tmp_path / "none", as_input([b"{}"]))


@pytest.mark.slow
def test_killed_a_hundred_times_the_output_is_the_same(tmp_path, stream):
    """No kill leaves more or fewer bytes, whether it meets the start, a line or the end."""
    source = tmp_path / "log.jsonl"
    source.write_bytes(b"".join(line + b"\n" for line in stream))
    out = tmp_path / "changes.jsonl"
    command = [sys.executable, "-m", "tiswarm", "track", source, "--out", out, "--quiet", *SET]

    def start():
        return subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL)

    began = time.monotonic()
    assert start().wait() == 0
    whole, took = out.read_bytes(), time.monotonic() - began
    out.unlink()
    out.with_name("changes.jsonl.journal").unlink()
    for kill in range(100):
        running = start()
        time.sleep(took * ((kill * 0.618) % 1.0))
        running.send_signal(signal.SIGKILL)
        running.wait()
        cut = out.read_bytes() if out.exists() else b""
        assert whole.startswith(cut)
        if cut == whole:
            out.unlink()
            out.with_name("changes.jsonl.journal").unlink()

    assert start().wait() == 0
    assert out.read_bytes() == whole
