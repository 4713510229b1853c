"""`tiswarm view --live` follows the output of `tiswarm track`, and only reads."""

import json
import re
import signal
import subprocess
import sys
from urllib.request import urlopen

import pytest

from tests.browser import dump
from tests.localization.test_online import QUICK, lines_of
from tests.localization.test_stream import as_input
from tests.runs import REPOSITORY, environment, interruptible
from tests.structures import NOISY
from tiswarm.base.errors import InputError
from tiswarm.cli import main
from tiswarm.localization.online.stream import follow
from tiswarm.report.stream_page import StreamPages
from tiswarm.sensing import observe


@pytest.fixture(scope="module")
def followed(towers, tmp_path_factory):
    """Output of a stream of nine robots, one of which leaves; one line is refused."""
    header, *robots = lines_of(observe(towers[1], NOISY))[:10]
    header = json.dumps({**json.loads(header), "version": 3})
    leave = json.dumps({"event": "leave", "robot": 4})
    lines = [header, *robots[:7], leave, leave, *robots[7:]]
    out = tmp_path_factory.mktemp("stream") / "changes.jsonl"
    tracker = follow(
        as_input(line.encode() for line in lines), out, out.with_name("changes.jsonl.journal"),
        params=QUICK, on_refused=[].append, on_resumed=[].append,
    )  # fmt: skip
    return out, tracker


def copied(folder, out, lines, *, more=b""):
    """Copy the first lines of a stream's output and journal, and part of a line of each."""
    for name in (out.name, f"{out.name}.journal"):
        whole = out.with_name(name).read_bytes().splitlines(keepends=True)
        (folder / name).write_bytes(b"".join(whole[:lines]) + more)
    return folder / out.name


def rows_of(page):
    """Read the table of robots of a page: name, place and sd of each."""
    table = page.partition('aria-label="Robots"')[2].partition("</table>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", table, re.DOTALL)[1:]
    return [re.findall(r"<td[^>]*>(.*?)</td>", re.sub(r"</?span[^>]*>", "", row)) for row in rows]


@pytest.mark.trial
def test_lines_appear_as_they_are_answered(followed, tmp_path):
    """The newest comes first. A line that is being written waits; files that began anew count."""
    out, _ = followed
    pages = StreamPages(copied(tmp_path, out, 5, more=b'{"li'))

    assert pages.update() == "5"
    assert "4 robots after 5 lines." in pages.listing("5")
    copied(tmp_path, out, 12)
    assert pages.update() == "12"
    listing = pages.listing("12")
    assert "9 robots after 12 lines, 1 of them refused." in listing
    assert re.findall(r'href="case/(\d+)"', listing) == [str(line) for line in range(12, 1, -1)]
    for what in ("robot 8 joined", "robot 4 left", "refused: robot: robot 4 has left"):
        assert what in listing
    copied(tmp_path, out, 3)
    assert pages.update() == "3"
    assert pages.listing("3").count("<tr>") == 3


def test_the_page_of_a_line_has_the_robots_after_it(followed):
    """Positions are the tracker's, as rounded in its output; refused lines are warnings."""
    out, tracker = followed
    pages = StreamPages(out)

    rows = rows_of(pages.case("12"))

    assert [row[0] for row in rows] == [str(name) for name in tracker.names]
    for row, place, sd in zip(rows, tracker.positions, tracker.sd, strict=True):
        assert [float(cell) for cell in row[1:4]] == pytest.approx(place, abs=0.01)
        assert float(row[4]) == pytest.approx(sd, rel=0.01, abs=1e-6)
    assert [row[6] for row in rows] == ["yes" if name == 4 else "" for name in tracker.names]
    assert "line 10: robot: robot 4 has left" in pages.case("12")
    earlier = pages.case("6")
    assert len(rows_of(earlier)) == 5
    assert "Warnings" not in earlier
    assert "After line 6: robot 4 joined" in earlier
    assert '<canvas id="view"' in earlier
    assert [pages.case(name) for name in ("1", "13", "0", "-1", "x", "", "1e1")] == [None] * 7


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (1, b"{}"),
        (1, b"not JSON"),
        (3, b'{"line": 3, "robots": 2, "annealed": false, "moved": [{"robot": 1}]}'),
        (3, b'{"line": 7, "robots": 2, "annealed": false, "moved": []}'),
        (3, b'{"line": 3, "refused": 1}'),
        (3, b"[]"),
    ],
)
def test_other_files_are_refused(followed, tmp_path, line, text):
    """The message names the line, and what the file should be."""
    out = copied(tmp_path, followed[0], 6)
    lines = out.read_bytes().splitlines()
    out.write_bytes(b"\n".join([*lines[: line - 1], text, *lines[line:], b""]))

    with pytest.raises(InputError, match=rf"changes.jsonl:{line}: this is no output of tiswarm tr"):
        StreamPages(out)


def test_a_journal_of_another_stream_is_refused(followed, tmp_path):
    """Its robots are not those of the output."""
    out = copied(tmp_path, followed[0], 6)
    journal = out.with_name("changes.jsonl.journal")
    journal.write_bytes(journal.read_bytes().replace(b'{"robot": 2', b'{"robot": 77'))

    with pytest.raises(InputError, match=r"changes.jsonl:4: the journal has robot 77 there"):
        StreamPages(out)
    journal.unlink()
    with pytest.raises(InputError, match=r"there is no changes.jsonl.journal beside it"):
        StreamPages(out)


@pytest.mark.parametrize(
    ("journal", "problem"),
    [
        (None, "log.jsonl: there is no log.jsonl.journal beside it; give the output of tiswarm tr"),
        ("{}\n", "log.jsonl:1: this is no output of tiswarm track"),
    ],
)
def test_a_log_is_no_stream(monkeypatch, capsys, tmp_path, journal, problem):
    """The command says which file it takes, with status 2."""
    log = tmp_path / "log.jsonl"
    log.write_text("{}\n")
    if journal is not None:
        log.with_name("log.jsonl.journal").write_text(journal)
    monkeypatch.setattr(sys, "argv", ["tiswarm", "view", "--live", str(log)])

    with pytest.raises(SystemExit) as ended:
        main()

    assert ended.value.code == 2
    assert problem in capsys.readouterr().err


def test_a_browser_shows_the_newest_line(followed):
    """The server answers with list and page; Ctrl-C is the usual end."""
    out, _ = followed
    with interruptible():
        process = subprocess.Popen(
            [sys.executable, "-m", "tiswarm", "view", "--live", str(out)],
            cwd=REPOSITORY, env=environment(), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
    with process:
        try:
            url = process.stdout.readline().split()[-1]
            with urlopen(f"{url}cases/", timeout=60) as answer:  # noqa: S310 - our own server
                assert "9 robots after 12 lines" in answer.read().decode()
            done = dump(url, "--virtual-time-budget=5000")
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=30)
        finally:
            process.kill()

    assert re.search('<a href="case/12" aria-current', done.stdout)
    assert re.search('<iframe [^>]*src="[^"]*case/12"', done.stdout)
    assert "show the newest line" in done.stdout
    assert (process.returncode, error) == (0, "")
