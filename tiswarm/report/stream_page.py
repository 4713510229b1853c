"""The page of a stream that `tiswarm track` follows: its lines, and the robots after each.

What the command writes is only read: its output and its journal, and of both only what is new.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import at_line, decode, unreadable
from tiswarm.records.messages import counted
from tiswarm.records.sensing_builder import SensingLogBuilder
from tiswarm.records.sensing_events import parse_line
from tiswarm.records.sensing_format import parse_header
from tiswarm.report.log_page import gather_log_page
from tiswarm.report.page import Page, render
from tiswarm.report.space import SD, Coloring, space_data, view_data
from tiswarm.report.swarm_view import view_log

_LISTED = 500
"""Lines in the list, the newest; every line has a page."""

_NAMED = 5
"""Robots that a line names, those that moved farthest."""

_WARNED = 20
"""Refused lines that the page of a line names, the last ones."""


class StreamPages:
    """A stream's lines and their answers, as far as both are written."""

    def __init__(self, out: Path) -> None:
        """Read what there is.

        Raises:
            InputError: this is no output of `tiswarm track`, or it has no journal beside it.
        """
        self.lock = Lock()  # of all methods: each request has a thread
        self._out, self._journal = out, out.with_name(f"{out.name}.journal")
        if not self._journal.is_file():
            problem = (
                f"there is no {self._journal.name} beside it; give the output of tiswarm track"
            )
            raise InputError(problem, path=out)
        self._start()
        self.update()

    def _start(self) -> None:
        self._read = {self._out: 0, self._journal: 0}  # bytes
        self._raw: dict[Path, list[bytes]] = {self._out: [], self._journal: []}
        self._answers: list[dict[str, Any]] = []
        self._now = _StreamState(self._out)

    def update(self) -> str:
        """Read the lines that were added since the last call; return the state of the stream."""
        if any(_size(path) < read for path, read in self._read.items()):
            self._start()  # somebody deleted the files and began anew
        for path in self._raw:
            new = _whole_lines(path, self._read[path])
            self._read[path] += len(new)
            self._raw[path].extend(new.split(b"\n")[:-1])
        done = min(map(len, self._raw.values()))
        for number in range(len(self._answers) + 1, done + 1):
            answer, text = self._raw[self._out][number - 1], self._raw[self._journal][number - 1]
            self._answers.append(_answer(answer, self._out, number))
            self._now.take(self._answers[-1], text, number)
        return str(done)

    def page(self) -> str:
        """Render the page that shows the list of lines and the chosen one."""
        return render("live.html", name=self._out.name, what="line")

    def listing(self, state: str) -> str:
        """Render the lines, the newest first."""
        refused = sum("refused" in answer for answer in self._answers)
        robots = counted(len(self._now.position), "robot")
        result = f"{robots} after {counted(len(self._answers), 'line')}"
        result += f", {refused} of them refused." if refused else "."
        last = self._answers[:0:-1][:_LISTED]
        unit = self._now.unit
        shown = [
            {"line": answer["line"], "what": self._what(answer), **_moves(answer, unit)}
            for answer in last
        ]
        links = [f"case/{answer['line']}" for answer in last]
        left = len(self._answers) - 1 - len(last)
        return render(
            "live-list.html",
            state=state, result=result, rows=[*zip(links, shown, strict=True)],
            words=["what", "annealed"],
            note=f"The list lacks the first {counted(left, 'line')}." if left > 0 else "",
        )  # fmt: skip

    def case(self, name: str) -> str | None:
        """Render the page of a line, the header being 1; None where there is no such line."""
        if not name.isdecimal() or not 1 < int(name) <= len(self._answers):
            return None
        swarm, last = self._now, int(name)
        if last < len(self._answers):
            swarm = _StreamState(self._out)
            for number, answer in enumerate(self._answers[:last], start=1):
                swarm.take(answer, self._raw[self._journal][number - 1], number)
        refused = [
            f"line {answer['line']}: {answer['refused']}; skipped"
            for answer in self._answers[:last]
            if "refused" in answer
        ]
        more = len(refused) - _WARNED
        warnings = [f"{counted(more, 'line')} before were refused, too"] if more > 0 else []
        return swarm.page(
            f"After line {last}: {self._what(self._answers[last - 1])}",
            [*warnings, *refused[-_WARNED:]],
        ).html()

    def _what(self, answer: dict[str, Any]) -> str:
        """Say in a word or two what a line was."""
        if "refused" in answer:
            return f"refused: {answer['refused']}"
        entries = json.loads(self._raw[self._journal][answer["line"] - 1])
        events = {"leave": "left", "release": "let go", "replace": "sensed more"}
        return f"robot {entries['robot']} {events.get(entries.get('event'), 'joined')}"


class _StreamState:
    """The robots after some lines of a stream, and who the last of these moved."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._builder: SensingLogBuilder | None = None
        self.position: dict[int, list[float]] = {}
        self._sd: dict[int, float] = {}
        self._moved: dict[int, float] = {}

    @property
    def unit(self) -> str:
        """Name of the unit of length."""
        return "R" if self._builder is None else self._builder.header.length_unit

    def take(self, answer: dict[str, Any], raw: bytes, number: int) -> None:
        """Take a line as far as it was answered."""
        self._moved = {}
        if "refused" in answer:
            return
        with at_line(self._out.with_name(f"{self._out.name}.journal"), number):
            text = decode(raw, self._out, number)
            if self._builder is None:
                self._builder = SensingLogBuilder(parse_header(text))
                return
            line = parse_line(text, self._builder.header)
            self._builder.take(line)
        for each in answer["moved"]:
            self.position[each["robot"]], self._sd[each["robot"]] = each["position"], each["sd"]
            self._moved[each["robot"]] = math.nan if each["moved"] is None else each["moved"]
        if line.robot not in self.position:
            problem = f"the journal has robot {line.robot} there; give the output of its own stream"
            raise InputError(problem, path=self._out, line=number)

    def page(self, name: str, warnings: Sequence[str]) -> Page:
        """Gather the page of the robots, colored by sd and by how far each moved."""
        if self._builder is None or not self.position:
            return Page(name=name, result="No robot has joined.", warnings=warnings)
        log = self._builder.log()
        names = log.robot_id.tolist()
        sd = np.array([self._sd[robot] for robot in names])
        estimate = Estimate(
            robot_id=log.robot_id,
            position=np.array([self.position[robot] for robot in names]),
            disconnected=np.zeros(len(names), np.bool_),
            sd=sd,
            gone=log.is_gone if log.gone.size else None,
            iteration=np.empty(0, np.int64),
            trace=np.empty((0, len(names), 3)),
            residual=np.empty(0),
            length_unit=log.length_unit,
        )
        view = view_log(log, estimate, name="estimate")
        page = gather_log_page(
            view, estimate, name=name, scores={}, warnings=warnings, notes=self._notes(),
            advice=[], figures=[],
        )  # fmt: skip
        moved = np.array([self._moved.get(robot, 0.0) for robot in names])
        values: Reals = np.where(log.is_gone, np.nan, np.stack([sd, moved]))
        labels = [SD, "moved by the line"]
        colorings = [Coloring(*each) for each in zip(labels, [self.unit] * 2, values, strict=True)]
        space = space_data(
            view.dock_offset_body, [view_data(view, colorings)],
            radius=log.dock_radius, unit=self.unit,
        )  # fmt: skip
        return replace(page, view=page.view and page.view._replace(data=space))

    def _notes(self) -> list[str]:
        """Say who moved by the last line, the farthest first."""
        ways = {robot: way for robot, way in self._moved.items() if not math.isnan(way)}
        if not ways:
            return ["The line moved no robot that had joined."]
        order = sorted(ways, key=lambda robot: -ways[robot])
        named = [f"{robot} by {ways[robot]:.3g} {self.unit}" for robot in order[:_NAMED]]
        more = ["..."] * (len(ways) > _NAMED)
        return [f"The line moved {counted(len(ways), 'robot')}: {', '.join([*named, *more])}"]


def _moves(answer: dict[str, Any], unit: str) -> dict[str, str]:
    """Write what a line changed as cells by heading."""
    if "refused" in answer:
        return {"robots": "", "moved": "", f"farthest [{unit}]": "", "annealed": ""}
    ways = [each["moved"] for each in answer["moved"] if each["moved"] is not None]
    return {
        "robots": str(answer["robots"]),
        "moved": str(len(ways)),
        f"farthest [{unit}]": f"{max(ways):.3g}" if ways else "",
        "annealed": "yes" if answer["annealed"] else "",
    }


def _answer(raw: bytes, path: Path, number: int) -> dict[str, Any]:
    """Read a line of the output; it has all that the pages need of it."""
    try:
        answer = json.loads(raw)
        right = answer["line"] == number and isinstance(answer.get("refused", ""), str)
        if number > 1 and "refused" not in answer:
            right &= isinstance(answer["robots"], int) and isinstance(answer["annealed"], bool)
            for each in answer["moved"]:
                x, y, z = each["position"]
                numbers = [x, y, z, each["sd"], each["moved"] or 0.0]
                right &= bool(np.isfinite(numbers).all()) and isinstance(each["robot"], int)
    except (ValueError, KeyError, TypeError, AttributeError):
        right = False
    if not right:
        problem = "this is no output of tiswarm track; give the file that it wrote by --out"
        raise InputError(problem, path=path, line=number)
    found: dict[str, Any] = answer
    return found


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise unreadable(path, error) from error


def _whole_lines(path: Path, start: int) -> bytes:
    """Read the lines that a file has from a byte on, without one that is being written."""
    try:
        with path.open("rb") as file:
            file.seek(start)
            content = file.read()
    except OSError as error:
        raise unreadable(path, error) from error
    return content[: content.rfind(b"\n") + 1]
