"""Shows structures while they grow: on a page that loads what is new, or in a notebook's cell.

A robot is written once, when it has joined. Loads and ground change with every join; they are
written anew each time the structure has grown by a tenth. So the size of all files grows as the
number of robots does, and watching takes the same share of the time of small and large structures.

The page works from a file, whose scripts can fetch nothing: it loads small scripts beside it, again
and again the one that says how far growth is, and each of those with new robots once.
"""

import html
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tiswarm.app.console import ConsoleProgress
from tiswarm.app.results import FRAME
from tiswarm.base.progress import Watch
from tiswarm.compute.math import dock_offsets
from tiswarm.records.terrain import Terrain
from tiswarm.report.page import Page
from tiswarm.report.swarm_view import MOST_ROBOTS, Coloring, View, ground_pieces, space_data
from tiswarm.world.ground.surface import shown_ground
from tiswarm.world.growth import GrowingStructure
from tiswarm.world.history import DIED

PAGE = "live.html"
"""File of the page."""

FOLDER = "live"
"""Folder beside it, of the scripts that it loads."""

MOST_STRUCTURES = 100
"""Structures that are shown; those that grow beside them are counted alone."""

_EVERY_S = 0.5
"""Least time between two looks at structures."""

_NEWS = 1.02
"""Factor by which robots are more before they are written, unless they have waited long."""

_LONGEST_S = 10.0
"""Longest time that robots wait for that."""

_ANEW = 1.1
"""Factor by which a structure has grown before its loads and its ground are written anew."""


class LiveProgress(ConsoleProgress):
    """Progress that also shows structures while they grow.

    The end of the block is that of all growth: the page then says so, also of an interruption.
    """

    def __init__(self, *, quiet: bool = False, name: str) -> None:
        """Show progress unless `quiet`, and structures in any case.

        Args:
            quiet: Whether to hide progress.
            name: Heading of the page.
        """
        super().__init__(quiet=quiet)
        self.name = name
        self.show: _Display | None = None
        self._line = ""

    def __exit__(self, *error: object) -> None:
        """Say on the page how growth ended."""
        kind = error[0] if error else None
        if self.show is None:
            if kind is None:
                self.console.print("--live: all structures had grown before", markup=False)
            return
        how = "Growth has ended."
        if kind is not None:
            how = "Interrupted." if kind is KeyboardInterrupt else "Ended by an error."
        self._write([], f"{self._line} {how}".strip(), ended=True)

    def begun(self, run: Path) -> None:
        """Report nothing yet: the page that shows more is named as soon as it is there."""

    @contextmanager
    def watch(
        self, names: Sequence[str], robots: int, folder: Path | None = None
    ) -> Iterator[Watch]:
        """Show structures while the block runs, in place of those that were shown before."""
        room = max(1, min(MOST_STRUCTURES, MOST_ROBOTS // robots, len(names)))
        growth = _Growth(names, robots, room)
        is_first = self.show is None
        if self.show is None:
            # Without a run the page is in a new folder of temporary files.
            place = folder or Path(tempfile.mkdtemp(prefix="tiswarm-"))
            self.show = _Cell(self.name) if self.cell else _Folder(self.name, place)
        latest: Sequence[GrowingStructure] = ()
        begun_s = shown_s = time.perf_counter()
        self._write([growth.beginning], growth.line(latest, 0.0))
        if is_first and isinstance(self.show, _Folder) and not self.show.is_closed:
            # Opened by nobody, it is named in a line, also if progress is hidden.
            self.console.print(f"to watch robots join: open {self.show.page}", markup=False)

        def look(structures: Sequence[GrowingStructure]) -> None:
            nonlocal latest, shown_s
            latest = structures
            now_s = time.perf_counter()
            if now_s - shown_s < _EVERY_S:
                return
            is_due = growth.has_news(structures) or now_s - shown_s >= _LONGEST_S
            if is_due:
                self._write(growth.news(structures), growth.line(structures, now_s - begun_s))
                shown_s = time.perf_counter()  # the next look does not follow a slow one at once

        try:
            yield look
        finally:
            took_s = time.perf_counter() - begun_s
            self._write(growth.news(latest, is_last=True), growth.line(latest, took_s))

    def _write(self, news: Sequence[dict[str, Any]], line: str, *, ended: bool = False) -> None:
        """Show what is new; where that cannot be written, growth goes on unseen."""
        self._line = line
        if self.show is None or self.show.is_closed:
            return
        try:
            self.show.write(news, line, ended=ended)
        except OSError as error:
            self.show.is_closed = True
            why = error.strerror or error
            problem = f"{PAGE} cannot be written: {why}; growth goes on without it"
            self.console.print(problem, markup=False)


class _Growth:
    """Structures that grow side by side, and how much of each is written."""

    def __init__(self, names: Sequence[str], robots: int, room: int) -> None:
        self.count = len(names)
        self.robots = robots
        self.names = list(names[:room])
        self.shown = [_Written() for _ in self.names]
        self._joined = 0

    @property
    def beginning(self) -> dict[str, Any]:
        """What a page begins with: structures without robots."""
        return {"names": self.names}

    def has_news(self, structures: Sequence[GrowingStructure]) -> bool:
        """Whether enough robots have joined since they were last written."""
        return _joined(structures) >= max(1.0, _NEWS * self._joined)

    def news(
        self, structures: Sequence[GrowingStructure], *, is_last: bool = False
    ) -> list[dict[str, Any]]:
        """List what is new since the last call, for each structure that changed."""
        self._joined = _joined(structures)
        shown = zip(structures, self.shown, strict=False)
        news = [written.news(structure, is_last=is_last) for structure, written in shown]
        return [{"structure": n, **entry} for n, entry in enumerate(news) if entry]

    def line(self, structures: Sequence[GrowingStructure], took_s: float) -> str:
        """State robots, height and time in a sentence."""
        robots = f"{_joined(structures):,} of {self.robots * self.count:,} robots"
        if self.count > 1:
            robots += f" in {self.count} structures"
        heights = [written.height for written in self.shown if written.height is not None]
        height = ""
        if heights:
            low, high = f"{min(heights):.1f}", f"{max(heights):.1f}"
            height = f", height {high} R" if low == high else f", heights {low} to {high} R"
        few = f" {len(self.names)} structures are shown." if len(self.names) < self.count else ""
        return f"{robots}{height}, {took_s:.1f} s.{few}"


class _Written:
    """How much of a structure is written."""

    def __init__(self) -> None:
        self.robots = 0
        self.departures = 0
        self.broken = 0
        self.described = 0  # robots when loads and ground were written last
        self.center_z: list[float] = []
        self.gone: set[int] = set()
        self.height: float | None = None  # of the highest center above the ground [R]

    def news(self, structure: GrowingStructure, *, is_last: bool) -> dict[str, Any]:
        """List what is new: robots, robots that are gone, contacts that broke, loads and ground."""
        walks = structure.walks[self.robots :]
        unit = structure.robot.dock_radius
        center = [(walk.center[-1] / unit).round(3).tolist() for walk in walks]
        gone = [
            robot for robot, _, event in structure.departures[self.departures :] if event != DIED
        ]
        offsets = structure.dock_offset_body / unit
        news: dict[str, Any] = {
            "offsets": [] if self.robots else offsets.tolist(),
            "center": center,
            "turn": [walk.orientation_wxyz[-1].round(4).tolist() for walk in walks],
            "contacts": self._contacts(structure),
            "gone": gone,
            "broken": [[a, b] for a, b, _ in structure.broken[self.broken :]],
        }
        self.robots = len(structure.walks)
        self.departures = len(structure.departures)
        self.broken = len(structure.broken)
        self.center_z += [z for _, _, z in center]
        self.gone.update(gone)
        present = [z for robot, z in enumerate(self.center_z) if robot not in self.gone]
        self.height = max(present) - structure.terrain.ground_z if present else None
        has_grown = self.robots >= max(1.0, _ANEW * self.described)
        if has_grown or (is_last and self.robots):
            self.described = self.robots
            news["load"] = [_figures(load) for load in structure.sensed.tolist()]
            news["ground"] = self._ground(structure)
        return {name: values for name, values in news.items() if values}

    def _contacts(self, structure: GrowingStructure) -> list[list[int]]:
        """List contacts of new robots, rows of (neighbor, its dock, robot, its dock)."""
        return [
            [neighbor, neighbor_dock, robot, dock]
            for robot, walk in enumerate(structure.walks[self.robots :], start=self.robots)
            for dock, neighbor, neighbor_dock in walk.at_rest(walk.contacts).tolist()
        ]

    def _ground(self, structure: GrowingStructure) -> list[Any]:
        """List the pieces of ground around the robots, as the 3D view has them."""
        terrain = structure.terrain
        # Uneven ground is measured around all robots, which takes the whole history.
        ground = terrain if isinstance(terrain, Terrain) else shown_ground(structure.history())
        present = [w for n, w in enumerate(structure.walks) if n not in self.gone]
        if not present:
            return []
        center = np.array([walk.center[-1] for walk in present])
        turn = np.array([walk.orientation_wxyz[-1] for walk in present])
        dock = center[:, None] + dock_offsets(turn, structure.dock_offset_body)
        pieces = ground_pieces(ground, dock.reshape(-1, 3) / structure.robot.dock_radius)
        return [faces.round(2).tolist() for faces in pieces]


def _joined(structures: Sequence[GrowingStructure]) -> int:
    return sum(len(structure.walks) for structure in structures)


def _figures(load: float) -> float | None:
    """Round a load to three digits; None where it is unknown."""
    return float(f"{load:.3g}") if np.isfinite(load) else None


class _Display(Protocol):
    """Where structures are shown."""

    is_closed: bool

    def write(self, news: Sequence[dict[str, Any]], line: str, *, ended: bool) -> None:
        """Show what is new, and a sentence; `ended` says that nothing follows."""


class _Folder:
    """A page, and the scripts in a folder beside it."""

    def __init__(self, name: str, place: Path) -> None:
        self.is_closed = False
        self._name = name
        self._place = place
        self.page = place / PAGE
        self._first = self._next = 0
        self._is_written = False

    def write(self, news: Sequence[dict[str, Any]], line: str, *, ended: bool) -> None:
        """Write new robots into a script of their own, then the one that says how far growth is."""
        scripts = self._place / FOLDER
        if not self._is_written:
            scripts.mkdir(exist_ok=True)
            for old in scripts.glob("*.js"):
                old.unlink()
            _put(self.page, _page(self._name, line, {"folder": FOLDER}))
            self._is_written = True
        if news:
            if "names" in news[0]:
                self._first = self._next
            _put(scripts / f"{self._next}.js", _script(news))
            self._next += 1
        results = "report.html" if ended and (self._place / "report.html").is_file() else ""
        state = {
            "first": self._first,
            "next": self._next,
            "line": line,
            "ended": ended,
            "results": results,
        }
        _put(scripts / "state.js", _script(state))


class _Cell:
    """A page in the output of a notebook's cell, which is replaced."""

    def __init__(self, name: str) -> None:
        self.is_closed = False
        self._name = name
        self._news: list[dict[str, Any]] = []
        self._handle: Any = None

    def write(self, news: Sequence[dict[str, Any]], line: str, *, ended: bool) -> None:  # noqa: ARG002
        """Show the page with all that has grown so far."""
        if news and "names" in news[0]:
            self._news.clear()
        self._news += news
        page = html.escape(_page(self._name, line, {"news": self._news}))
        content = {"text/html": f'<iframe srcdoc="{page}" {FRAME}></iframe>', "text/plain": line}
        if self._handle is None:
            display = import_module("IPython.display").display  # a notebook has it
            self._handle = display(content, raw=True, display_id=True)
        else:
            self._handle.update(content, raw=True)


def _put(path: Path, text: str) -> None:
    """Replace a file at once; unlike results, it need not survive a power cut."""
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def _script(value: object) -> str:
    return f"tiswarm({json.dumps(value, separators=(',', ':'))})\n"


def _page(name: str, line: str, growth: dict[str, Any]) -> str:
    """Write the page that shows structures from `news`, or from scripts in a `folder`."""
    coloring = Coloring("sensed load", "dock weights", np.empty(0), "forces")
    data = space_data(np.empty((0, 3)), [])
    data["coloring"] = coloring._asdict() | {"value": []}
    view = View(data=data, title="Structures", choice="Structure", note="", robots="robots")
    return Page(name=name, result=line, view=view, growth=growth).html()
