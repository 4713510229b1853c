"""Serves the cases of a run folder to a browser on this machine, as they are finished.

The server only reads files. It answers on the loopback address and opens no other connection.
"""

import socketserver
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import pandas as pd

from tiswarm import study
from tiswarm.base.errors import EnvironmentTroubleError, TiswarmError
from tiswarm.records.messages import counted
from tiswarm.report.page import Page, render
from tiswarm.report.page_tables import PageTable, case_table
from tiswarm.report.run_data import RunData, named_run
from tiswarm.report.swarm_view import build_view
from tiswarm.study.store import CaseRecord
from tiswarm.study.tables import summary

_HOST = "127.0.0.1"
_LISTED = ("case", "status", "robots", "RMSE [R]", "reason")
"""Columns of the list of cases; the page of a case has all."""


def serve(run: Path, port: int, announce: Callable[[str], None]) -> None:
    """Serve a run folder until the user interrupts; then return.

    Args:
        run: Folder of a run, finished or not.
        port: Port to listen on; 0 takes a free one.
        announce: Receives the address of the page once it is served.

    Raises:
        InputError: this is no folder of a run.
        EnvironmentTroubleError: the port is in use or reserved.
    """
    live = _LiveRun(run)
    try:
        server = _Server((_HOST, port), partial(_Handler, live))
    except OSError as error:
        msg = f"--port: {port} cannot be used: {error.strerror}; choose another one"
        raise EnvironmentTroubleError(msg) from error
    with server, suppress(KeyboardInterrupt):
        announce(f"http://{_HOST}:{server.server_address[1]}/")
        server.serve_forever()


class _LiveRun:
    """A run folder, whose cases are read once each."""

    def __init__(self, path: Path) -> None:
        self._folder, whole = study.open_folder(path)
        self._cases = whole.cases
        self.lock = Lock()  # of all methods: each request has a thread
        self._records: dict[
            str, tuple[int, CaseRecord]
        ] = {}  # by name, with the time of the record

    def update(self) -> str:
        """Read the cases that were stored since the last call; return the state of the folder."""
        for case in self._cases:
            try:
                stored = (self._folder.cases / case.name / "case.json").stat().st_mtime_ns
            except OSError:  # not yet finished, or about to be replaced
                continue
            if self._records.get(case.name, (0, None))[0] != stored:
                record = self._folder.read_case(case.name)
                if record is not None:
                    self._records[case.name] = stored, record
        newest = max((stored for stored, _ in self._records.values()), default=0)
        return f"{len(self._records)}-{newest}"

    def page(self) -> str:
        """Render the page that shows the list of cases and the chosen one."""
        return render("live.html", name=self._folder.path.resolve().name)

    def listing(self, state: str) -> str:
        """Render the cases, the newest first."""
        newest_first = sorted(self._records.items(), key=lambda item: (-item[1][0], item[0]))
        failed = sum(not record.is_done for _, (_, record) in newest_first)
        result = f"{len(newest_first)} of {counted(len(self._cases), 'case')} finished"
        result += f", {failed} of them failed." if failed else "."
        if not newest_first:
            return render("live-list.html", state=state, result=result, rows=[], words=[], note="")
        table = case_table(self._finished([name for name, _ in newest_first]), in_words=True)
        shown = table.frame[[name for name in _LISTED if name in table.frame]].to_dict("records")
        links = [f"case/{quote(name)}?{stored}" for name, (stored, _) in newest_first]
        return render(
            "live-list.html",
            state=state,
            result=result,
            rows=[*zip(links, shown, strict=False)],
            words=table.words,
            note=table.note,
        )

    def case(self, name: str) -> str | None:
        """Render the page of a case; None where no such case is finished."""
        if name not in self._records:
            return None
        of_case = self._finished([name])
        title, *_ = case_table(of_case, in_words=True).frame["case"]
        cells = case_table(of_case).frame.drop(columns="case").iloc[0]
        cells = cells[cells != ""]
        quantities = pd.DataFrame({"quantity": cells.index, "value": cells.to_numpy()})
        return Page(
            name=title,
            result="" if self._records[name][1].is_done else "The case failed.",
            headline=PageTable(frame=quantities, words=["quantity"], title="Case"),
            view=build_view(RunData(self._folder.path, of_case)),
        ).html()

    def _finished(self, names: list[str]) -> pd.DataFrame:
        """Tabulate some cases as in `summary.csv`, with the names that all finished ones give."""
        settings = {case.name: case.settings for case in self._cases}
        records = [record for _, record in self._records.values()]
        table = summary(records, [settings[record.case] for record in records])
        named = named_run(self._folder.path, table).summary
        return named.set_index("case", drop=False).loc[names].reset_index(drop=True)


class _Server(socketserver.ThreadingTCPServer):
    """A server that looks up no names, which HTTPServer does."""

    allow_reuse_address = True
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401 - as the base
        """Ignore browsers that leave in the middle of an answer."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    def __init__(self, live: "_LiveRun", *connection: Any) -> None:  # noqa: ANN401 - as the base
        self._live = live
        super().__init__(*connection)

    def do_GET(self) -> None:
        """Answer with the page, the list of cases if it has changed, or one of them."""
        try:
            host = urlsplit(f"//{self.headers['Host']}").hostname
            path = urlsplit(self.path).path
        except ValueError:  # a bracket of an address that does not end
            self.send_error(400)
            return
        # A page elsewhere whose name leads to this machine may not read the run.
        if host not in {_HOST, "localhost"}:
            self.send_error(403)
            return
        try:
            with self._live.lock:
                content = self._content(path)
        except TiswarmError as error:
            self.send_error(500, explain=str(error))
            return
        if content is None:
            self.send_error(404)
            return
        data = content.encode()
        self.send_response(200 if data else 204)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(data)

    def _content(self, path: str) -> str | None:
        """Return the content of an address: empty if it is unchanged, None if there is none."""
        section, _, name = path.removeprefix("/").partition("/")
        if section == "case":
            return self._live.case(unquote(name))
        if section == "cases":
            state = self._live.update()
            return "" if name == state else self._live.listing(state)
        return None if section else self._live.page()

    def log_message(self, *_: object) -> None:
        """Print nothing for each request."""
