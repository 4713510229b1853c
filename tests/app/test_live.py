"""`tiswarm view --live` serves the cases of a run folder as they are finished, and only reads."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import psutil
import pytest

from tests.browser import dump, probe_phone
from tests.runs import REPOSITORY, call_here, environment, interruptible

NO_RUN = "this is no run folder: it has no scenario.yaml; give a folder that a run made"


class Served:
    """A run folder that a child process serves, and a case that has yet to arrive."""

    def __init__(self, run, waiting):
        self.run = run
        self._waiting = waiting
        self.late = waiting.name
        with interruptible():
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tiswarm", "view", "--live", str(run)],
                cwd=REPOSITORY, env=environment(), text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
        self.url = self.process.stdout.readline().split()[-1]

    def get(self, path, **headers):
        """Fetch a page; returns its status and text."""
        try:
            request = Request(self.url + path, headers=headers)  # noqa: S310 - our own server
            with urlopen(request, timeout=60) as answer:  # noqa: S310
                return answer.status, answer.read().decode()
        except HTTPError as error:
            return error.code, error.read().decode()

    def finish_case(self):
        """Let the waiting case appear, as a study stores one."""
        if self._waiting.exists():
            self._waiting.rename(self.run / "cases" / self.late)


@pytest.fixture(scope="module")
def served(small_run, tmp_path_factory):
    """A copy of a small run that lacks its last case and its tables."""
    place = tmp_path_factory.mktemp("live")
    run = place / "run"
    shutil.copytree(small_run / "cases", run / "cases")
    shutil.copy(small_run / "scenario.yaml", run)
    last = max((run / "cases").iterdir())
    found = Served(run, last.rename(place / last.name))
    yield found
    found.process.kill()
    found.process.communicate()


def test_cases_appear_as_they_are_finished(served):
    """The list has each finished case, the newest first; the folder stays as it is.

    Conditions have the names of the report, with the measurements in which they differ.
    """
    before = {path: path.stat().st_mtime_ns for path in served.run.rglob("*")}
    stored = len([*(served.run / "cases").iterdir()])

    status, shell = served.get("")
    assert (status, 'id="cases"' in shell) == (200, True)
    _, first = served.get("cases/")
    assert f"{stored} of {stored + 1} cases finished." in first
    assert "RMSE [R]" in first
    state = re.search('data-state="(.*?)"', first)[1]
    assert served.get(f"cases/{state}") == (204, "")
    assert served.get(f"case/{served.late}")[0] == 404

    served.finish_case()
    _, second = served.get(f"cases/{state}")
    assert f"{stored + 1} of {stored + 1} cases finished." in second
    link = re.search('href="(.*?)"', second)[1]
    assert link.startswith(f"case/{served.late}?")
    status, page = served.get(link)
    assert status == 200
    assert '<canvas id="view"' in page
    seed, _, condition = served.late.partition("-")
    name = f"{condition} / without heights and non-overlap, seed {seed}"
    assert f'"name":"{name}"' in page
    assert f">{name}</h1>" in page
    assert f">{name}</a>" in second
    after = {path: path.stat().st_mtime_ns for path in served.run.rglob("*")}
    late = served.run / "cases"
    assert {path: time for path, time in after.items() if path in before and path != late} == {
        path: time for path, time in before.items() if path != late
    }
    assert {path.relative_to(late).parts[0] for path in {*after} - {*before}} == {served.late}


def test_only_this_machine_can_read_the_run(served):
    """It listens on the loopback address, and answers no page of another name, nor other files."""
    sockets = psutil.Process(served.process.pid).net_connections()
    # A browser of another test may still be connected.
    listening = [each.laddr.ip for each in sockets if each.status == psutil.CONN_LISTEN]

    assert listening == ["127.0.0.1"]
    assert served.get("cases/", Host="example.org")[0] == 403
    assert served.get("cases/", Host="localhost:8000")[0] == 200
    assert served.get("case/../../scenario.yaml")[0] == 404
    assert served.get("case/%2e%2e%2fscenario.yaml")[0] == 404
    assert served.get("scenario.yaml")[0] == 404


@pytest.mark.parametrize(("line", "host"), [("/", "["), ("http://[::1/", "localhost")])
def test_a_malformed_address_is_a_bad_request(served, line, host):
    """The answer is 400, and the terminal stays silent, as the end of the command shows."""
    port = int(served.url.rstrip("/").rpartition(":")[2])

    with socket.create_connection(("127.0.0.1", port), timeout=60) as browser:
        browser.sendall(f"GET {line} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        answer = browser.makefile("rb").readline()

    assert answer.split()[1] == b"400"


def test_an_address_of_any_length_is_answered(served):
    """Long numbers once filled the terminal; the end of the command shows that it stays silent."""
    assert served.get(f"case/{'9' * 5000}")[0] == 404


def test_the_page_shows_the_newest_case(served):
    """A browser lists the cases and loads the newest one."""
    served.finish_case()

    done = dump(served.url, "--virtual-time-budget=5000")

    assert re.search(f'<a href="case/{served.late}[^"]*" aria-current', done.stdout)
    assert re.search(f'<iframe [^>]*src="[^"]*case/{served.late}', done.stdout)


@pytest.mark.trial
def test_a_case_takes_the_whole_width_of_a_phone(served, tmp_path):
    """Margins of the list and of the case together left 342 of 390 pixels to the 3D view."""
    _, shell = served.get("")
    script = """
        const { left, width } = inside.querySelector("iframe").getBoundingClientRect();
        Object.assign(found, { left, width, wide: inside.documentElement.scrollWidth });
    """

    found = probe_phone(shell, script, tmp_path)

    assert (found["left"], found["width"], found["wide"]) == (0, 390, 390)


@pytest.mark.trial
def test_ctrl_c_ends_the_command(served):
    """It is the usual end: status 0, and not a word on standard error."""
    served.process.send_signal(signal.SIGINT)
    _, error = served.process.communicate(timeout=30)

    assert (served.process.returncode, error) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "status", "problem"),
    [
        (["--live", "."], 2, f".: {NO_RUN}"),
        (["--live", "nowhere"], 2, f"nowhere: {NO_RUN}"),
        (
            ["--live", ".", "--out", "a.html"],
            2,
            "--out: --live shows a run; leave it out",
        ),
        (["log.jsonl", "--port", "8000"], 2, "--port: only --live serves a page; leave it out"),
    ],
)
def test_mistakes_are_one_line(arguments, status, problem, tmp_path):
    """The message says what is wrong; nothing is served or written."""
    assert _said(*arguments, cwd=tmp_path) == (status, problem)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("name", ["fifo", "run/scenario.yaml"])
def test_a_pipe_does_not_block_the_command(tmp_path, name):
    """It is refused before anything waits for its other end."""
    (tmp_path / "run").mkdir()
    os.mkfifo(tmp_path / name)

    status, said = _said("--live", str(tmp_path / name.split("/")[0]))

    assert status == 2
    assert "this is no run folder" in said or "it is a link or no regular file" in said


def test_a_port_in_use_is_refused(small_run):
    """The message names the port."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])

        status, said = _said("--live", str(small_run), "--port", port)

    assert status == 1
    assert said.startswith(f"--port: {port} cannot be used: ")


def _said(*arguments, cwd=REPOSITORY):
    """Call `tiswarm view` in this process; returns its status and its one line of error."""
    done = call_here("view", *arguments, cwd=cwd)
    (line,) = done.stderr.splitlines()
    return done.returncode, line.removeprefix("tiswarm: error: ")
