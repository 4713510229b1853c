"""Structures grow, sense, score, show and save themselves as a library."""

import json
import pickle
import re
import warnings
import zipfile

import numpy as np
import pandas as pd
import pytest

import tiswarm as library
from tiswarm.app import swarms as module
from tiswarm.base import plugins, registry
from tiswarm.base.errors import InputError, ResultWarning
from tiswarm.base.robot import RobotGeometry
from tiswarm.report.pictures.pictures import build_pictures
from tiswarm.world.params import BridgeParams, ClimbParams

pytestmark = pytest.mark.filterwarnings("ignore::tiswarm.base.errors.ResultWarning")
"""A short `joint` does not converge, and says so."""

QUICK = {"chains": 1, "steps": 10, "hold_steps": 5, "refine": False}
"""Settings of a `joint` that takes little time."""

BRIDGES = {"kind": "bridge", "gap": 12.0}
"""Bridges that some seeds close with fewer robots than others."""


@pytest.fixture(scope="module")
def towers():
    """Two towers of eight robots."""
    return library.grow("tower", robots=8, seeds=[3, 1], quiet=True)


@pytest.fixture(scope="module")
def bridges():
    """Three bridges, some of which end early."""
    found = library.grow(BRIDGES, robots=12, seeds=3, quiet=True)
    assert len({*found.robot_count.tolist()}) > 1  # or nothing is padded
    return found


@pytest.fixture
def _forget():
    """Leave no plug-in to the next test."""
    yield
    plugins.forget()


def test_growth_in_python_is_that_of_a_run(tmp_path):
    """Logs and estimates have the bytes of the files, and scores are those of the summary."""
    scenario = {
        "name": "same", "robots": 8, "seeds": 2, "structure": {"kind": "tower", "movers": 2},
        "sensing": {"tilt_noise_deg": 1.0, "missed_contacts": 0.1},
        "localization": {"method": "joint", **QUICK},
    }  # fmt: skip
    run = library.run(scenario, out=tmp_path, pictures=False, quiet=True)

    grown = library.grow({"kind": "tower", "movers": 2}, robots=8, seeds=2, quiet=True)
    logs = grown.sense(tilt_noise_deg=1.0, missed_contacts=0.1)
    estimates = [log.localize("joint", **QUICK) for log in logs]
    scores = grown.score(estimates)

    for swarm, log, estimate in zip(grown, logs, estimates, strict=True):
        case = run.folder / "cases" / f"{swarm.seed}-baseline"
        folder = tmp_path / str(swarm.seed)
        folder.mkdir()
        written = log.write(folder / "log.jsonl"), estimate.write(folder / "estimate.csv")
        for file, name in zip(written, ("sensing.jsonl", "estimate.csv"), strict=True):
            assert file.read_bytes() == (case / name).read_bytes()
        truth = pd.read_csv(case / "truth.csv", float_precision="round_trip")
        assert np.array_equal(swarm.position, truth[["x_R", "y_R", "z_R"]])
    grown = pd.read_csv(case / "growth.csv", float_precision="round_trip")
    pd.testing.assert_frame_equal(swarm.growth, grown, check_dtype=False, check_exact=True)
    summary = run.summary[scores.columns].astype(float)
    pd.testing.assert_frame_equal(scores.astype(float), summary, check_exact=True)


def test_arrays_are_those_of_the_histories(bridges):
    """Every place of every array is what the robot's walk has, or blank behind the last robot."""
    for s, swarm in enumerate(bridges):
        for n in range(12):
            if n >= swarm.robot_count:
                assert np.isnan(bridges.position[s, n]).all()
                assert np.isnan(bridges.orientation_wxyz[s, n]).all()
                assert np.isnan([bridges.sensed_load[s, n], bridges.peak_stress[s, n]]).all()
                assert bridges.join_round[s, n] == bridges.flips[s, n] == -1
                assert not bridges.is_recruited[s, n]
                continue
            walk = swarm.history.walks[n]
            assert bridges.position[s, n].tolist() == walk.center[-1].tolist()
            assert bridges.orientation_wxyz[s, n].tolist() == walk.orientation_wxyz[-1].tolist()
            assert bridges.join_round[s, n] == walk.round
            assert bridges.flips[s, n] == len(walk.pivot_dock)
            assert bridges.is_recruited[s, n] == walk.recruited
            assert bridges.peak_stress[s, n] == swarm.history.loads[n].peak
            assert bridges.sensed_load[s, n] == swarm.history.sensed[n]
            assert bridges.is_anchor[s, n] == (n == 0)
    assert bridges.height.tolist() == [s.position[:, 2].max() for s in bridges]  # ground at 0
    assert bridges.reach.tolist() == [s.position[:, 0].max() for s in bridges]
    assert [bool(why) for why in bridges.ended] == (bridges.robot_count < 12).tolist()


def test_rows_start_with_their_structure(bridges):
    """Contacts, docks and stances of all are those of each, one after the other."""
    lists = ("contacts", "ground_docks", "edge_docks", "stance_contacts")
    for name in lists:
        rows = [[s, *row] for s, each in enumerate(bridges) for row in getattr(each, name).tolist()]
        assert getattr(bridges, name).tolist() == rows
    stances = bridges.stances
    place = 0
    for s, swarm in enumerate(bridges):
        for n, walk in enumerate(swarm.history.walks):
            mine = slice(place, place + walk.stance_count)
            assert (stances.structure[mine] == s).all()
            assert (stances.robot[mine] == n).all()
            assert np.array_equal(stances.center[mine], walk.center)
            assert stances.pivot_dock[mine].tolist() == [*walk.pivot_dock, -1]
            place += walk.stance_count
    assert place == len(stances.center) == len(stances.orientation_wxyz)


@pytest.mark.parametrize("kind", ["leave", "die"])
def test_arrays_have_the_robots_that_left(kind, tmp_path):
    """Each row of departures has its robot, and the round of the join that it followed."""
    structure = {"kind": "tower", "departures": {"rate": 0.4, "kind": kind}}
    found = library.grow(structure, robots=12, seeds=2, quiet=True)
    left = [[-1] * 12, [-1] * 12]
    gone = np.zeros((2, 12), np.bool_)

    assert len(found.departures) > 2
    for s, robot, joined, event in found.departures.tolist():
        left[s][robot] = found[s].history.walks[joined - 1].round
        gone[s, robot] = event != 2
        assert (event == 2) == (kind == "die")
        assert np.isnan(found.sensed_load[s, robot])
    assert found.leave_round.tolist() == left
    assert (found.leave_round >= found.join_round)[found.leave_round >= 0].all()
    assert np.array_equal(found.is_gone, gone)
    again = library.open_swarms(found.save(tmp_path / "left.npz"))
    assert again.departures.tolist() == found.departures.tolist()
    assert found.view(tmp_path / "left.html").is_file()


def test_a_batch_is_a_sequence(towers):
    """It has single structures and parts, in the order of the seeds that were given."""
    assert towers.seed.tolist() == [3, 1]
    assert [each.seed for each in towers] == [3, 1]
    assert towers[-1].seed == 1
    assert towers[:1].position.shape == (1, 8, 3)
    assert np.array_equal(towers[1].position, towers.position[1])
    with pytest.raises(IndexError):
        towers[2]


def test_structures_print_themselves(towers, bridges):
    """A table has a row for each structure, and a column of reasons where growth ended early."""
    lines = str(towers).splitlines()

    assert lines[0] == "2 structures (tower) of 8 robots"
    assert lines[1].split() == [
        "seed",
        "joined",
        "height_R",
        "reach_R",
        "peak_stress",
        "[dock",
        "weights/R^2]",
        "growth_rounds",
    ]
    assert lines[2].split()[:3] == ["3", "8", f"{towers.height[0]:.1f}"]
    assert len(lines) == 4
    assert repr(towers) == str(towers)
    assert "the gap is bridged by" in str(bridges)
    assert str(towers[0]).startswith("1 structure (tower) of 8 robots\n")
    assert "<td>3</td>" in towers._repr_html_()


def test_structures_are_read_back(bridges, tmp_path):
    """Arrays, settings and logs are the same; saved again, they have the same bytes."""
    file = bridges.save(tmp_path / "some.npz")
    again = library.open_swarms(file)

    assert again.scenario == bridges.scenario
    assert again.ended == bridges.ended
    for name in ("position", "sensed_load", "peak_stress", "join_round", "stance_contacts"):
        np.testing.assert_array_equal(getattr(again, name), getattr(bridges, name))
    pd.testing.assert_frame_equal(again.table, bridges.table)
    before = file.read_bytes()
    assert again.save(file, overwrite=True).read_bytes() == before
    single = library.open_swarms(bridges[1].save(tmp_path / "one.npz"))
    assert single.seed.tolist() == [1]


def test_files_that_are_no_structures_are_refused(towers, tmp_path):
    """Missing, foreign and damaged files have a line that names them; none is replaced."""
    whole = towers.save(tmp_path / "whole.npz")
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole.read_bytes()[:-2000])
    foreign = tmp_path / "foreign.npz"
    np.savez(foreign, position=np.zeros(3))
    less = tmp_path / "less.npz"
    with zipfile.ZipFile(whole) as old, zipfile.ZipFile(less, "w") as new:
        for name in old.namelist():
            if name != "1/center.npy":
                new.writestr(name, old.read(name))

    for file, problem in [
        (tmp_path / "none.npz", "there is no such file"),
        (cut, "is damaged, or no file of structures"),
        (foreign, "is damaged, or no file of structures"),
        (less, "is damaged; grow"),
    ]:
        with pytest.raises(InputError, match=f"^{re.escape(str(file))}: {problem}"):
            library.open_swarms(file)
    with pytest.raises(
        InputError, match=r"foreign\.npz: exists already; give overwrite=True or another path"
    ):
        towers.save(foreign)
    assert towers.save(foreign, overwrite=True).read_bytes() == whole.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"structure": "towr"}, "structure.kind: .*; did you mean tower?"),
        ({"structure": 3}, "structure: 3 should be keys with values"),
        ({"structure": {"goal_height": 3.0}}, "structure.kind: "),
        (
            {"structure": {"kind": "tower", "goal_heigth": 3.0}},
            "structure.goal_heigth: unknown key; did you mean goal_height?",
        ),
        (
            {"structure": {"kind": "tower", "navigate_by": "estimate"}},
            'structure.navigate_by: .* need a method; give believe, as believe="online"',
        ),
        (
            {"navigate_by": "error"},
            "structure.navigate_by: error needs belief_error, as {kind: independent, size: 0.5}",
        ),
        (
            {"navigate_by": "truth", "belief_error": {"kind": "shift", "size": 1.0}},
            "structure.navigate_by: truth does not go with belief_error; set error",
        ),
        (
            {"navigate_by": "error", "believe": "online"},
            "believe: robots that go by the truth and an error estimate nothing; leave believe out",
        ),
        (
            {"navigate_by": "truth", "believe": "online"},
            "believe: robots that know the truth estimate nothing; leave believe out, or set",
        ),
        (
            {"sensing": {"tilt_noise_deg": 1.0}},
            "sensing: robots that know the truth go by no sensor; leave sensing out, or give",
        ),
        ({"believe": "onlne"}, "localization.method: .*; did you mean online?"),
        ({"believe": "none"}, "localization.method: robots navigate by estimates"),
        (
            {"believe": lambda log: np.zeros(log.robot_count)},
            r"believe: returned ndarray of shape \(1,\); return finite centers of shape \(1, 3\)",
        ),
        (
            {"believe": lambda log: (np.zeros((log.robot_count, 3)), [-1.0])},
            "believe: returned list of shape",
        ),
        ({"believe": lambda _: "nowhere"}, "believe: returned str"),
        ({"robots": 1}, "robots: 1 should be greater"),
        ({"seeds": [1, 1]}, "seeds: 1 occurs twice"),
        ({"seeds": range(-1, 2)}, "seeds.*: -1 should be greater"),
        ({"robot": {"rh": 2.0}}, "robot.rh: unknown key; did you mean rho?"),
        ({"threads": 0}, "threads: 0 threads cannot compute"),
    ],
)
def test_arguments_are_checked_as_a_scenario_is(arguments, problem):
    """A mistake has the line that a scenario with it has."""
    with pytest.raises(InputError, match=f"^{problem}"):
        library.grow(**{"structure": "tower", "robots": 4, **arguments})


@pytest.mark.parametrize(
    ("settings", "plain"),
    [
        (
            {"structure": BridgeParams(gap=30.0, climb=ClimbParams(patience=5))},
            {"structure": {"kind": "bridge", "gap": 30.0, "climb": {"patience": 5}}},
        ),
        ({"structure": BridgeParams}, {"structure": "bridge"}),
        ({"robot": RobotGeometry(rho=1.7)}, {"robot": {"rho": 1.7}}),
        (
            {"robot": "square", "seeds": range(2, 4)},
            {"robot": {"shape": "square"}, "seeds": [2, 3]},
        ),
        ({"robots": np.int64(3), "seeds": np.arange(2)}, {"robots": 3, "seeds": [0, 1]}),
    ],
)
def test_settings_are_objects_or_plain_data(settings, plain):
    """Both grow the same."""
    one, other = (
        library.grow(**{"structure": "tower", "robots": 3, **each}, quiet=True)
        for each in (settings, plain)
    )

    assert one.scenario == other.scenario
    assert np.array_equal(one.position, other.position)


def test_settings_of_sensing_are_checked(towers):
    """The line names the key of the section."""
    with pytest.raises(InputError, match=r"^sensing.tilt_noise: unknown key; did you mean tilt_"):
        towers.sense(tilt_noise=1.0)


def test_scores_need_an_estimate_of_each_structure(towers):
    """Another number, a bare array and an estimate of another structure are refused."""
    logs = towers.sense()
    known = [log.with_estimate(log.localize(**QUICK)) for log in logs]
    other = library.grow("tower", robots=4, quiet=True)[0].sense().localize(**QUICK)

    with pytest.raises(InputError, match=r"^estimates: 1 estimates are not 2"):
        towers.score(known[:1])
    with pytest.raises(InputError, match=r"^estimates: a value of type ndarray has no log"):
        towers.score([towers[0].position, towers[1].position])
    with pytest.raises(InputError, match=r"^estimates: the estimate of tower-seed-0 is of another"):
        towers.score([other, known[1]])
    with pytest.raises(InputError, match=r"^estimates: the estimate of tower-seed-1 is of another"):
        towers[0].score(known[1])
    with pytest.raises(InputError, match=r"^estimates: estimates 0 and 1 are both of tower-seed-3"):
        towers.score([known[0], known[0]])


def test_a_log_of_a_file_with_other_robots_is_refused(towers, tmp_path):
    """Its number of robots is not that of the structure."""
    file = library.grow("tower", robots=4, quiet=True)[0].sense().write(tmp_path / "log.jsonl")
    other = library.read_log(file).localize(**QUICK)

    with pytest.raises(InputError, match=r"^estimates: 4 robots, but 8 joined tower-seed-3"):
        towers[0].score(other)


@pytest.mark.parametrize("order", [[2, 1, 0], [1, 2, 0], [0, 2, 1]])
@pytest.mark.parametrize("source", ["sensed", "sent", "files"])
def test_scores_are_those_of_the_structures_in_any_order_of_estimates(order, source, tmp_path):
    """As pools of workers and lists of files return them; `sent` logs went through a pickle."""
    grown = library.grow("tower", robots=8, seeds=3, quiet=True)
    logs = grown.sense(tilt_noise_deg=1.0, missed_contacts=0.1, false_contacts=0.1)
    if source == "sent":
        logs = pickle.loads(pickle.dumps(logs))  # noqa: S301 - of this test
    if source == "files":
        files = [log.write(tmp_path / f"{n}.jsonl") for n, log in enumerate(logs)]
        logs = [library.read_log(file) for file in files]
    estimates = [log.localize("hop-by-hop") for log in logs]

    scores = grown.score([estimates[n] for n in order])

    pd.testing.assert_frame_equal(scores, grown.score(estimates), check_exact=True)
    assert scores["seed"].tolist() == [0, 1, 2]
    assert scores["rmse_R"].max() < 3.0  # where they were exchanged, 7 R


def test_an_exact_estimate_scores_zero(towers, tmp_path):
    """A table of the truth, read as an estimate, has no error."""
    swarm = towers[0]
    log = swarm.sense()
    table = tmp_path / "truth.csv"
    columns = dict(zip(("x_R", "y_R", "z_R"), swarm.position.T, strict=True))
    pd.DataFrame({"robot": range(8), **columns}).to_csv(table, index=False)

    scores = swarm.score(log.with_estimate(table))

    assert scores["rmse_R"] == pytest.approx(0.0, abs=1e-12)
    assert scores["height_R"] == swarm.totals["height_R"]


@pytest.mark.parametrize(
    ("form", "files"),
    [
        ("csv", ["contacts.csv", "structure.csv"]),
        ("gltf", ["case.glb"]),
        ("ply", ["contacts.ply", "structure.ply"]),
        ("mcap", ["case.mcap"]),
        ("tum", ["structure.tum"]),
        ("pyfg", ["case.pyfg"]),
        ("mjcf", ["case.xml"]),
        ("wbt", ["case.wbt"]),
    ],
)
def test_exports_have_the_structure_and_no_estimate(towers, tmp_path, form, files):
    """There is none: no file or part of a file is of one."""
    folder = towers.export(form, seed=1, out=tmp_path / "out", quiet=True)

    found = sorted(path.name for path in folder.iterdir() if path.suffix)
    assert found == files
    assert not any(b"estimate" in (folder / name).read_bytes() for name in files)
    if form == "csv":
        places = pd.read_csv(folder / "structure.csv", float_precision="round_trip")
        assert np.array_equal(places[["x_R", "y_R", "z_R"]], towers[1].position)


def test_the_page_has_every_structure(towers, tmp_path):
    """Robots are at their true places, colored by load; nothing is called estimated."""
    page = towers.view(tmp_path / "towers.html").read_text()
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])

    assert [case["name"] for case in data["cases"]] == ["tower-seed-3", "tower-seed-1"]
    for case, swarm in zip(data["cases"], towers, strict=True):
        assert np.allclose(case["estimate"], swarm.position, atol=1e-4)
        assert case["true"] == []
        assert [color["label"] for color in case["colors"]] == ["sensed load"]
    assert "</span> robots</label>" in page
    assert "</span> estimated</label>" not in page
    assert f"height {towers.height.mean():.3g} R in the mean" in page
    assert towers[0].view(tmp_path / "one.html").read_text().count("tower-seed-3") >= 2


def test_a_page_has_room_for_some_structures(towers, tmp_path, monkeypatch):
    """The table has all; the view has the first ones, and says so."""
    for name, most in (("_MOST_STRUCTURES", 1), ("MOST_ROBOTS", 15)):
        with monkeypatch.context() as patched:
            patched.setattr(module, name, most)
            page = towers.view(tmp_path / f"{name}.html").read_text()
        data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])
        assert [case["name"] for case in data["cases"]] == ["tower-seed-3"]
        assert "It contains the first 1 of 2 structures." in page


def test_structures_pass_between_processes(bridges):
    """What a worker grew is the same here."""
    again = pickle.loads(pickle.dumps(bridges))  # noqa: S301 - of this test

    assert np.array_equal(again.position, bridges.position, equal_nan=True)
    assert again.scenario == bridges.scenario


def test_pictures_of_a_structure_have_no_estimate(towers):
    """Structure, loads and contacts are drawn; there is no error."""
    pictures = build_pictures(towers[0]._shown())  # noqa: SLF001 - what all pictures show

    assert [*pictures] == ["structure", "sensed-force", "contact-graph"]


@pytest.mark.trial
def test_a_structure_is_rendered_with_its_growth(towers, tmp_path):
    """The folder has the pictures and the film."""
    figures = towers.render(
        tmp_path / "renders", seed=3, movie="gif", renderer="taichi", quiet=True
    )

    assert {"structure", "sensed-force", "contact-graph", "growth"} <= {*figures}
    assert (tmp_path / "renders" / "growth.gif").read_bytes().startswith(b"GIF8")
    with pytest.raises(InputError, match=r"^seed: there is no '2'; choose one of 3, 1"):
        towers.render(tmp_path / "renders", seed=2)


LEANING = '''
import numpy as np
import tiswarm
from tiswarm.world.params import TowerParams

@tiswarm.structure("leaning")
class Leaning(TowerParams):
    """A tower whose goal is to the side."""

    lean: float = 0.0
    """Distance of the goal from the axis [R]."""

    def goal(self, side):
        return np.array([self.lean, 0.0, self.goal_height])
'''


@pytest.mark.usefixtures("_forget")
def test_structures_of_a_plugin_grow_and_are_read_back(tmp_path):
    """The file of structures names the kind; whoever reads it loads the plug-in."""
    own = tmp_path / "own.py"
    own.write_text(LEANING)
    leaning = {"kind": "leaning", "lean": 20.0}
    grown = library.grow(leaning, robots=6, seeds=2, plugins=[own], quiet=True)
    file = grown.save(tmp_path / "leaning.npz")

    again = library.open_swarms(file)
    assert np.array_equal(again.position, grown.position)
    assert str(again).startswith("2 structures (leaning)")
    plugins.forget()
    with pytest.raises(InputError, match=r"leaning.npz: structure.kind: .*a plug-in that you load"):
        library.open_swarms(file)
    assert len(library.open_swarms(file, plugins=[own])) == 2


WALK = '''
import numpy as np
import tiswarm

@tiswarm.rule("first-flip")
class FirstFlip:
    """Take the first possible flip until another robot is touched."""

    flips: int = 40
    """Flips before a climber stays."""

    def choose(self, step):
        touches = (step.touching >= 0).any(axis=(1, 2))
        stays = touches | (step.stance >= self.flips) | ~step.possible.any(axis=1)
        return np.where(stays, -1, step.possible.argmax(axis=1))
'''


IDLE = """
import tiswarm


@tiswarm.rule("idle")
class Idle:
    def choose(self, step):
        return -1
"""


@pytest.mark.parametrize(("seeds", "more"), [(2, "1 more reason"), (3, "2 more reasons")])
def test_a_warning_counts_the_reasons_that_it_leaves_out(seeds, more):
    """Towers of weak docks that fall after different joins; one reason is singular."""
    tower = {"kind": "tower", "recruit_limit": 0, "strength": {"limit": 60.0}}
    early = rf"^{seeds} of {seeds} structures ended .* the structure fell once .* \(and {more}\)$"

    with pytest.warns(ResultWarning, match=early):
        library.grow(tower, robots=12, seeds=seeds, quiet=True)


@pytest.mark.usefixtures("_forget")
def test_structures_that_end_early_are_one_warning(bridges, tmp_path):
    """Its reason names the rule that was chosen; a bridge that closes is no early end."""
    (tmp_path / "idle.py").write_text(IDLE)
    early = r"^2 of 2 structures ended before all robots joined: .*or correct the rule idle$"
    with pytest.warns(ResultWarning, match=early) as found:
        grown = library.grow("tower", robots=4, seeds=2, rule="idle",
                             plugins=[tmp_path / "idle.py"], quiet=True)  # fmt: skip
    assert len(found) == 1
    assert grown.robot_count.tolist() == [1, 1]
    closed = [each.seed for each in bridges if each.ended.startswith("the gap is bridged")]
    assert closed
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        library.grow(BRIDGES, robots=12, seeds=closed, quiet=True)


@pytest.mark.usefixtures("_forget")
def test_a_rule_is_a_name_keys_or_a_class(tmp_path):
    """All ways grow the same, which differs from ReactiveBuild; the file names the rule."""
    own = tmp_path / "own.py"
    own.write_text(WALK)
    first, *others = (
        library.grow("tower", robots=6, seeds=2, rule=rule, plugins=[own], quiet=True)
        for rule in ("first-flip", {"name": "first-flip"}, {"name": "first-flip", "flips": 40})
    )
    within = {"kind": "tower", "rule": {"name": "first-flip"}}
    registered = registry.get("rule", "first-flip")
    others += [library.grow(within, robots=6, seeds=2, quiet=True)]
    others += [library.grow(robots=6, seeds=2, rule=each, quiet=True)
               for each in (registered, registered(flips=40))]  # fmt: skip

    for other in others:
        assert np.array_equal(other.position, first.position, equal_nan=True)
    built_in = library.grow("tower", robots=6, seeds=2, quiet=True)
    assert not np.array_equal(built_in.position, first.position)
    again = library.open_swarms(first.save(tmp_path / "own.npz"))
    assert again.scenario.structure.rule.name == "first-flip"
    for rule, problem in [
        ("first-flop", r"structure\.rule.*did you mean first-flip\?"),
        (
            {"name": "first-flip", "flip": 3},
            r"structure\.rule\.flip: unknown key; did you mean flips",
        ),
    ]:
        with pytest.raises(InputError, match=f"^{problem}"):
            library.grow("tower", robots=6, rule=rule)


def test_long_growth_shows_its_progress(capsys):
    """The line says how many robots joined; nothing is printed where it is to be quiet."""
    library.grow("tower", robots=3, seeds=2)
    assert re.search(r"grow: 6 in [\d.]+ s", capsys.readouterr().err)
    library.grow("tower", robots=3, seeds=2, quiet=True)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("strength", "has_margins"),
    [(None, False), ({"limit": 250.0}, True), ({"law": "tension", "limit": 69.0}, False)],
    ids=["any load", "von Mises", "no contact is pulled"],
)
def test_the_page_of_structures_shows_margins_where_contacts_have_them(
    tmp_path, strength, has_margins
):
    """In the view and in its tables, where no number is missing."""
    settings = {"kind": "tower"} if strength is None else {"kind": "tower", "strength": strength}
    swarms = library.grow(settings, robots=2, seeds=2, quiet=True)

    page = swarms.view(tmp_path / "view.html").read_text()

    assert ('"label":"margin"' in page) == has_margins
    assert ("least margin" in page) == has_margins
    assert ("broken contacts" in page) == (strength is not None)
    assert "nan" not in re.findall(r"<td[^>]*>(.*?)</td>", page)
    assert "nan to nan" not in page
