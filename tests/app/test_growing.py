"""Structures can be watched while they grow: `tiswarm run --live`, `tiswarm.grow(live=True)`."""

import json
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tiswarm as api
from tests.browser import dump
from tests.runs import REPOSITORY, environment, interruptible, repeated_files
from tiswarm.app import console, growing
from tiswarm.app.growing import LiveProgress
from tiswarm.app.swarms import growth_scenario
from tiswarm.world import growth

SMALL = ("--set", "robots=12", "--set", "seeds=2", "--no-pictures")
LEAVING = {"kind": "tower", "departures": {"rate": 0.4}}
FALLING = {"kind": "tower", "recruit_limit": 0, "strength": {"limit": 60.0}}


@pytest.fixture
def impatient(monkeypatch):
    """Robots are written after each round in which one joins."""
    monkeypatch.setattr(growing, "_EVERY_S", 0.0)
    monkeypatch.setattr(growing, "_NEWS", 1.0 + 1e-9)


@pytest.fixture
def place(monkeypatch, tmp_path):
    """Folder that structures without a run are shown in."""
    monkeypatch.setattr(growing.tempfile, "mkdtemp", lambda **_: str(tmp_path))
    return tmp_path


def read_script(path: Path):
    """Read the value that a script calls `tiswarm` with."""
    return json.loads(re.fullmatch(r"tiswarm\((.*)\)\n", path.read_text())[1])


def read_news(folder: Path) -> tuple[list[dict], dict]:
    """Read all news beside a page in order, and the state."""
    state = read_script(folder / "live" / "state.js")
    news = [read_script(folder / "live" / f"{n}.js") for n in range(state["next"])]
    return [entry for script in news for entry in script], state


def shown(page: Path) -> str:
    """Load a page from its file in a browser; returns the document that results."""
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    return dump(page.as_uri(), *options, "--virtual-time-budget=4000").stdout


def test_a_watched_run_has_the_same_bytes(tiswarm, tmp_path, impatient):
    """What is shown is read only: no case and no table differs."""
    runs = []
    for name, options in (("plain", ()), ("watched", ("--live",))):
        done = tiswarm("run", "tests/tower.yaml", *SMALL, *options, "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
        [run] = (tmp_path / name).glob("tower-*")
        runs.append(repeated_files(run))

    plain, watched = runs
    ours = {path for path in watched if path.parts[0] in {"live", "live.html"}}
    assert len(ours) > 10
    assert watched.keys() - ours == plain.keys()
    assert [path for path in plain if plain[path] != watched[path]] == []
    assert done.stderr.count("to watch") == 1
    assert f"to watch robots join: open {run / 'live.html'}" in done.stderr


def test_each_robot_is_written_once(place, impatient):
    """Together, the news are the structures; growth does not write all of it again and again."""
    swarms = api.grow("tower", robots=12, seeds=2, live=True, quiet=True)

    news, state = read_news(place)
    for s, swarm in enumerate(swarms):
        of_structure = [entry for entry in news if entry.get("structure") == s]
        gathered = {
            name: [row for entry in of_structure for row in entry.get(name, [])]
            for name in ("center", "turn", "contacts")
        }
        assert np.allclose(gathered["center"], swarm.position, atol=1e-3)
        assert np.allclose(gathered["turn"], swarm.orientation_wxyz, atol=1e-4)
        assert sorted(gathered["contacts"]) == sorted(swarm.contacts.tolist())
        *_, load = [entry["load"] for entry in of_structure if "load" in entry]
        assert np.allclose(load, swarm.sensed_load, rtol=5e-3)
    low, high = sorted(swarms.height.round(1))
    heights = f"heights {low} to {high} R"
    assert state["line"].startswith(f"24 of 24 robots in 2 structures, {heights}, ")
    assert (state["ended"], state["first"]) == (True, 0)


@pytest.mark.parametrize("robots", [12, pytest.param(300, marks=pytest.mark.trial)])
def test_what_is_written_grows_as_the_robots_do(place, robots, monkeypatch):
    """However often one looks, a robot adds rows of its own, and loads come at each tenth."""
    monkeypatch.setattr(growing, "_EVERY_S", 0.0)

    api.grow("tower", robots=robots, seeds=1, live=True, quiet=True)

    news, _ = read_news(place)
    loads = [entry["load"] for entry in news if "load" in entry]
    assert len(news) <= 60 + np.log(robots) / np.log(1.02)
    assert len(loads) <= 12 + np.log(robots) / np.log(1.1)
    assert sum(map(len, loads)) <= 12 * robots


@pytest.mark.parametrize("structure", [LEAVING, FALLING], ids=["leaving", "falling"])
@pytest.mark.filterwarnings("ignore:1 of 1 structure ended before")
def test_robots_that_are_gone_go_from_the_page(place, impatient, structure):
    """The page has the robots and contacts that remain, as the structure says."""
    [swarm] = api.grow(structure, robots=12, seeds=1, live=True, quiet=True)

    news, _ = read_news(place)
    gone = {robot for entry in news for robot in entry.get("gone", [])}
    assert gone == {*np.flatnonzero(swarm.is_gone).tolist()}
    assert gone
    broken = [ends for entry in news for ends in entry.get("broken", [])]
    assert len(broken) == len(swarm.broken)
    remaining = swarm.robot_count - len(gone)
    assert f'id="joined">{remaining} of {remaining}</output>' in shown(place / "live.html")


def test_robots_on_ground_of_any_form_are_shown(place, impatient):
    """Uneven ground is measured around the robots that have joined."""
    hill = {"kind": "tower", "terrain": [{"kind": "plane"}, {"kind": "sphere", "radius": 4.0}]}

    api.grow(hill, robots=6, seeds=1, live=True, quiet=True)

    news, _ = read_news(place)
    grounds = [entry["ground"] for entry in news if "ground" in entry]
    heights = [z for piece in grounds[-1] for face in piece for _, _, z in face]
    assert max(heights) > min(heights) + 1.0


def test_a_page_of_a_file_shows_what_has_grown(place, impatient):
    """It loads scripts beside it, up to the robots of the state, and says how growth ended."""
    api.grow("tower", robots=12, seeds=1, live=True, quiet=True)
    page = place / "live.html"

    whole = shown(page)
    assert 'id="joined">12 of 12</output>' in whole
    assert re.search(r"12 of 12 robots, height [\d.]+ R, [\d.]+ s\. Growth has ended\.</p>", whole)

    script = place / "live" / "state.js"
    state = read_script(script) | {"next": 6, "ended": False, "line": "5 of 12 robots."}
    script.write_text(f"tiswarm({json.dumps(state)})\n")
    part = shown(page)
    joined = int(re.search(r'id="joined">(\d+) of', part)[1])
    assert 0 < joined < 12
    assert "5 of 12 robots." in part


def test_a_page_shows_what_grows_now(tmp_path, impatient):
    """A run grows structures of a point of its sweep after those of another one."""
    scenario = growth_scenario("tower", 6, 1)
    with LiveProgress(quiet=True, name="two jobs") as progress:
        for seed in (0, 1):
            with progress.watch([f"seed {seed}"], 6, tmp_path) as watch:
                settings = {"robots": 6, "robot": scenario.robot, "watch": watch}
                growth.grow(scenario.structure, seeds=[seed], **settings)

    news, state = read_news(tmp_path)
    assert [entry["names"] for entry in news if "names" in entry] == [["seed 0"], ["seed 1"]]
    assert "names" in read_script(tmp_path / "live" / f"{state['first']}.js")[0]
    document = re.sub(r"<script.*?</script>", "", shown(tmp_path / "live.html"), flags=re.DOTALL)
    assert '<option value="0">seed 1</option>' in document
    assert "seed 0" not in document


def test_an_interruption_is_stated(place, capsys):
    """A page that waits for robots in vain would be worse than none."""
    with (
        pytest.raises(KeyboardInterrupt),
        LiveProgress(quiet=True, name="tower") as progress,
        progress.watch(["seed 0"], 12),
    ):
        raise KeyboardInterrupt

    _, state = read_news(place)
    assert state["ended"]
    assert state["line"].endswith("Interrupted.")
    assert str(place / "live.html") in capsys.readouterr().err.replace("\n", "")


@pytest.mark.trial
def test_ctrl_c_ends_a_watched_run(tmp_path):
    """The command says what to do, and the page that it was interrupted."""
    command = ["run", "tower", "--set", "robots=3000", "--set", "seeds=1", "--live"]
    with interruptible():
        process = subprocess.Popen(
            [sys.executable, "-m", "tiswarm", *command, "--out", str(tmp_path)],
            cwd=REPOSITORY, env=environment(), text=True, stderr=subprocess.PIPE,
        )  # fmt: skip
    while not [*tmp_path.glob("*/live/3.js")]:
        assert process.poll() is None
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)

    assert process.returncode == 130
    assert "interrupted; the same command again" in error
    [run] = tmp_path.glob("tower-*")
    _, state = read_news(run)
    assert state["ended"]
    assert state["line"].endswith("Interrupted.")


def test_a_page_that_cannot_be_written_stops_no_growth(tmp_path, capsys, impatient, monkeypatch):
    """Growth may take hours; where the disk is full, one line says that nothing is shown."""
    (tmp_path / "live.html").mkdir()
    monkeypatch.setattr(growing.tempfile, "mkdtemp", lambda **_: str(tmp_path))

    swarms = api.grow("tower", robots=6, seeds=1, live=True, quiet=True)

    assert swarms.robot_count.tolist() == [6]
    said = capsys.readouterr().err
    assert said.count("live.html cannot be written: ") == 1
    assert "growth goes on without it" in said


@pytest.mark.parametrize("option", [("--case-limit", 60), ("--workers", 2)])
def test_other_processes_cannot_be_watched(tiswarm, tmp_path, option):
    """They would grow structures that no page shows: refused, however little there is to do."""
    done = tiswarm("run", "tests/tower.yaml", "--live", *option, "--out", tmp_path)

    problem = "structures that other processes grow are not shown"
    fix = "leave out workers, scheduler and case limit"
    assert done.stderr == f"tiswarm: error: --live: {problem}; {fix}\n"
    assert (done.returncode, [*tmp_path.iterdir()]) == (2, [])


def test_a_run_that_grows_nothing_says_so(tiswarm, tmp_path):
    """All its cases are stored: a page would wait for ever."""
    command = ("run", "tests/tower.yaml", *SMALL, "--out", tmp_path)
    tiswarm(*command)

    done = tiswarm(*command, "--live")

    assert "--live: all structures had grown before" in done.stderr
    assert "to watch" not in done.stderr
    assert not [*tmp_path.glob("*/live.html")]


def test_a_notebook_shows_one_page_that_changes(monkeypatch, impatient):
    """The cell has one output; its last page contains all robots and needs no other file."""
    monkeypatch.setattr(console, "Console", partial(console.Console, force_jupyter=True))
    outputs = []

    def display(content, **_):
        outputs.append([content])
        return SimpleNamespace(update=lambda new, **_: outputs[-1].append(new))

    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    api.grow("tower", robots=12, seeds=1, live=True, quiet=True)

    [pages] = outputs
    assert len(pages) > 6
    assert pages[-1]["text/plain"].endswith("Growth has ended.")
    assert pages[-1]["text/html"].startswith('<iframe srcdoc="')
    assert "&#34;folder&#34;" not in pages[-1]["text/html"]
