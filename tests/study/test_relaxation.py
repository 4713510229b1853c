"""Studies of the engine: cases are runs of `tiswarm.relax`, measured and stored."""

import numpy as np
import pandas as pd
import pytest

import tiswarm as api
from tests.runs import QUIET, REPOSITORY, assert_same_bytes
from tiswarm import study
from tiswarm.app.drawing import draw_all
from tiswarm.base import plugins
from tiswarm.base.errors import ResultWarning
from tiswarm.compute.math import dock_offsets
from tiswarm.engine import laws
from tiswarm.engine.start import Ball, place
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.model import dump_scenario

SIZES = (5, 12)
STEPS = 6
BALLS = {
    "localization.force": "lennard-jones",
    "localization.integrator": "langevin",
    "localization.body": "ball",
    "localization.cutoff": 5.0,
    "localization.start": {"pitch": 2.4, "jitter": 0.1, "contact_band": 0.0},
    "localization.parameters": {"temperature": 0.5, "dt": 0.02},
}
DATA = {
    "name": "forces",
    "seeds": 2,
    "localization": {
        "method": "relax",
        "steps": STEPS,
        "max_step": 0.1,
        "trajectory": {"every": 4, "robots": 8},
    },
    "conditions": {"contact": {}, "balls": BALLS},
    "sweep": {"robots": [*SIZES]},
}
SPRING = """
import tiswarm

ti = tiswarm.ti


@tiswarm.force("spring")
def spring(distance, connected, spacing, stiffness):
    return ti.select(connected, stiffness * (distance - spacing), 0.0)


@tiswarm.integrator("slow")
def slow(force, share=0.5):
    return share * force
"""
STUDY = """name: springs
robots: 12
localization:
  method: relax
  steps: 4
  force: spring
  integrator: slow
"""
CHANGED = (
    "  parameters: {stiffness: 1.0}\nconditions:\n  a: {}\n  b: {localization: {method: joint}}\n"
)
"""A condition that would localize."""


@pytest.fixture(scope="module")
def relaxed(tmp_path_factory):
    """A drawn run of two forces at two sizes."""
    out = tmp_path_factory.mktemp("engine")
    result = study.run(load_scenario(DATA), out, progress=QUIET)
    draw_all(result, QUIET)
    return api.open_run(result.folder)


@pytest.fixture
def own(tmp_path):
    """A working folder with a plug-in, which is forgotten afterwards, and a scenario for it."""
    (tmp_path / "spring.py").write_text(SPRING)
    (tmp_path / "study.yaml").write_text(STUDY)
    yield tmp_path
    plugins.forget()


def positions(table):
    """Return the centers of a table, shape (N, 3)."""
    return table[["x_R", "y_R", "z_R"]].to_numpy()


def docks_of(run, case):
    """Place the docks of a case in the world, shape (N, docks, 3)."""
    robots = run.frame("robots", case=case)
    turn = robots[["qw", "qx", "qy", "qz"]].to_numpy()
    body = positions(run.frame("docks", case=case))
    return positions(robots)[:, None] + dock_offsets(turn, body)


def test_a_case_of_the_paper_is_a_call_of_relax(relaxed):
    """The study places robots and takes the steps that `tiswarm.relax` takes, to the last bit."""
    robot = api.RobotGeometry()
    start = place(12, 1, robot=robot, pitch=2.9, jitter=1.0, turned=True, band=0.16)
    expected = api.relax(
        start.position, start.orientation_wxyz, start.contacts, robot=robot, steps=STEPS,
        attraction_gain=0.05, repulsion_gain=0.04, ramp=0.5, max_step=0.1,
    )  # fmt: skip

    case = "1-robots=12,contact"

    np.testing.assert_array_equal(positions(relaxed.frame("robots", case=case)), expected.position)
    moves = relaxed.frame("moves", case=case)["largest_move_R"]
    np.testing.assert_array_equal(moves, expected.largest_move)
    assert len(start.contacts) == len(relaxed.frame("contacts", case=case)) > 0


def test_noise_follows_the_seed_of_the_case(relaxed):
    """Langevin dynamics of a case are those of the function with the seed of the case."""
    start = place(5, 1, robot=Ball(), pitch=2.4, jitter=0.1, turned=True, band=0.0)
    expected = api.relax(
        start.position, start.orientation_wxyz, start.contacts, robot=Ball(), steps=STEPS,
        force=laws.lennard_jones, integrator=laws.langevin, cutoff=5.0, max_step=0.1, seed=1,
        parameters={"temperature": 0.5, "dt": 0.02},
    )  # fmt: skip

    found = positions(relaxed.frame("robots", case="1-robots=5,balls"))

    np.testing.assert_array_equal(found, expected.position)


def test_trajectories_have_the_start_and_the_end(relaxed):
    """Every few steps and the last one are stored, of at most so many robots."""
    table = relaxed.frame("trajectory", case="0-robots=12,contact")
    robots = relaxed.frame("robots", case="0-robots=12,contact")

    assert table["step"].unique().tolist() == [0, 4, STEPS]
    assert table["robot"].unique().tolist() == [0, 2, 4, 6, 8, 10]
    last = table[table["step"] == STEPS]
    np.testing.assert_array_equal(positions(last), positions(robots.iloc[::2]))
    assert np.abs(positions(table[table["step"] == 0]) - positions(last)).max() > 0.01


def test_overlap_and_gap_are_those_of_all_pairs(relaxed):
    """Measures of the last state agree with sums over all pairs of docks."""
    for case in ("0-robots=12,contact", "1-robots=12,balls"):
        docks = docks_of(relaxed, case)
        contacts = relaxed.frame("contacts", case=case).to_numpy(int)
        connected = {(i, a, j, b) for i, a, j, b in contacts.tolist()}
        gaps = [np.linalg.norm(docks[i, a] - docks[j, b]) - 2.0 for i, a, j, b in connected]
        overlaps = [
            2.0 - np.linalg.norm(docks[i, a] - docks[j, b])
            for j in range(len(docks)) for i in range(j)
            for a in range(docks.shape[1]) for b in range(docks.shape[1])
            if (i, a, j, b) not in connected
        ]  # fmt: skip

        row = relaxed.summary.set_index("case").loc[case]

        assert row["greatest_overlap_R"] == pytest.approx(max(0.0, *overlaps), abs=1e-12)
        if gaps:
            rms = np.sqrt(np.mean(np.square(gaps)))
            assert row["contact_gap_R"] == pytest.approx(rms, rel=1e-12)
        else:
            assert np.isnan(row["contact_gap_R"])


def test_throughput_has_its_table_and_figure(relaxed):
    """Rates are robot steps over the measured time of the steps; the page shows them."""
    table = relaxed.frame("throughput")

    assert table["robot_count"].tolist() == [5, 5, 12, 12]
    rates = table[["robot_steps_per_cpu_s", "robot_steps_per_wall_s"]]
    assert (rates > 0.0).all(axis=None)
    assert {"throughput", "motion", "swarm", "moved", "overlap"} == {*relaxed.figures}
    page = relaxed.page.read_text()
    assert "robot steps / CPU s" in page
    assert "RMSE" not in str(relaxed)
    assert [*relaxed.answer][:4] == ["point", "condition", "n", "settled (95 % CI)"]


def test_columns_of_the_engine_that_the_page_of_files_lists_are_there(relaxed):
    """Readers of a file look them up."""
    page = pd.read_csv(REPOSITORY / "docs" / "columns.csv", keep_default_na=False)
    case = "0-robots=12,contact"
    columns = {f"{name}.csv": {*relaxed.frame(name, case=case)} for name in ("moves", "trajectory")}
    columns["throughput.csv"] = {*relaxed.frame("throughput")}

    for file, names in columns.items():
        listed = ", ".join(page[page["file"] == file]["column"]).split(", ")

        assert {*listed} <= names


def test_positions_repeat_and_cases_are_kept(relaxed, tmp_path):
    """All but times repeat to the byte; a case that lost a table is computed again."""
    scenario = load_scenario(DATA)
    run = study.run(scenario, tmp_path, progress=QUIET).folder
    next(run.glob("cases/*/moves.csv")).unlink()

    again = study.run(scenario, tmp_path, progress=QUIET)

    assert (again.computed, again.found) == (1, 7)
    assert_same_bytes(run / "cases", relaxed.folder / "cases")
    for name in ("summary.csv", "table.csv", "scenario.yaml"):
        assert (run / name).read_bytes() == (relaxed.folder / name).read_bytes()


def test_a_stored_study_of_the_engine_has_no_structure(relaxed):
    """Its scenario states what counts, and loads to the same study."""
    stored = relaxed.folder / "scenario.yaml"

    text = stored.read_text()

    assert "structure" not in text
    assert "sensing" not in text
    assert dump_scenario(load_scenario(stored)) == text


def test_the_last_state_is_exported(relaxed, tmp_path):
    """Other programs read robots and contacts as those of structures."""
    folder = relaxed.export("csv", out=tmp_path, case="0-robots=12,contact", quiet=True)

    table = pd.read_csv(folder / "structure.csv")

    np.testing.assert_allclose(
        table.filter(regex="^[xyz]").to_numpy()[:, :3],
        positions(relaxed.frame("robots", case="0-robots=12,contact")),
    )


def test_forces_and_integrators_of_a_user_are_chosen(own):
    """A spring of stiffness 1 and a share of a half halve the gap of a pair in one step."""
    run = api.run(
        own / "study.yaml", ["localization.steps=1", "localization.parameters.stiffness=0.5"],
        out=own, plugins=[own / "spring.py"], pictures=False, quiet=True,
    )  # fmt: skip
    start = place(12, 0, robot=api.RobotGeometry(), pitch=2.9, jitter=1.0, turned=True, band=0.16)
    docks = start.docks(api.RobotGeometry())
    expected = start.position.copy()

    for i, a, j, b in start.contacts.tolist():
        offset = docks[j, b] - docks[i, a]
        distance = np.linalg.norm(offset)
        step = 0.5 * 0.5 * (distance - 2.0) * offset / distance
        expected[i] += step
        expected[j] -= step

    [case] = run.summary["case"]
    np.testing.assert_allclose(positions(run.frame("robots", case=case)), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "place_of", "problem"),
    [
        ("  parameters: {stifness: 1.0}\n", "8: localization.parameters.stifness", "did you mean"),
        ("", "3: localization.parameters.stiffness", "is missing; give a number, or sweep it"),
        ("  cutoff: -1.0\n", "8: localization.cutoff", "-1.0 should be greater than 0"),
        ("  parameters: {stiffness: 1.0}\nstructure: {kind: tower}\n", "9: structure", "no use"),
        (
            "  parameters: {stiffness: 1.0}\nsweep: {structure.kind: [tower]}\n",
            "9: sweep.structure.kind",
            "no use",
        ),
        (
            "  parameters: {stiffness: 1.0}\nconditions: {a: {sensing.tilt_noise_deg: 1.0}}\n",
            "9: conditions.a.sensing.tilt_noise_deg",
            "no use",
        ),
        (
            CHANGED,
            "11: conditions.b",
            "relax is a study of its own",
        ),
    ],
)
def test_a_mistake_has_its_line_and_key(own, tiswarm, text, place_of, problem):
    """Mistakes in a study of the engine are lines, as in others; nothing is written."""
    file = own / "study.yaml"
    file.write_text(STUDY + text)

    done = tiswarm("run", file, "--plugin", own / "spring.py", "--out", own / "out")

    assert done.returncode == 2
    assert f"{file}:{place_of}" in done.stderr
    assert problem in done.stderr
    assert not (own / "out").exists()


def test_a_function_that_does_not_compile_is_a_line(own, tiswarm):
    """The study ends before its first case, with the file and line of the function."""
    (own / "spring.py").write_text(SPRING.replace("stiffness *", "hardness *"))
    given = ("--set", "localization.parameters.stiffness=1", "--out", own / "out")

    done = tiswarm("run", own / "study.yaml", "--plugin", own / "spring.py", *given)

    assert done.returncode in (1, 2)
    assert f"{own / 'spring.py'}:" in done.stderr
    assert "hardness" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_swarm_that_diverges_is_a_failed_case(tmp_path):
    """Other points of the sweep have results; the reason names what to change."""
    start = {"pitch": 1.0, "jitter": 0.0, "contact_band": 0.0}
    own = {"method": "relax", "steps": 30, "start": start, "body": "ball"}
    own |= {"force": "lennard-jones", "integrator": "verlet", "cutoff": 5.0}
    data = {
        "name": "far",
        "robots": 8,
        "localization": own,
        "sweep": {"localization.parameters.dt": [1e-6, 1e6]},
    }

    with pytest.warns(ResultWarning, match="1 case failed"):
        run = api.run(data, out=tmp_path, pictures=False, quiet=True)

    status = run.summary.set_index("localization.parameters.dt")["status"]
    reason = run.summary.set_index("localization.parameters.dt")["reason"]
    assert status.to_dict() == {1e-6: "done", 1e6: "failed"}
    assert "the forces diverged" in reason[1e6]


def test_a_study_of_structures_cannot_change_to_the_engine(tiswarm, tmp_path):
    """A condition of a structure has no swarm to move."""
    done = tiswarm("check", "tower", "--set", "conditions={a: {}, b: {localization.method: relax}}")

    assert done.returncode == 2
    assert "relax is a study of its own" in done.stderr


@pytest.mark.trial
def test_workers_find_forces_of_a_user(own):
    """A worker loads the plug-in of a force before the settings that name it."""
    plugins.load_plugins([own / "spring.py"])
    settings = ["seeds=2", "localization.parameters.stiffness=0.5"]
    scenario = load_scenario(own / "study.yaml", settings)

    alone, spread = (
        study.run(
            scenario, own / str(workers), progress=QUIET, execution=study.Execution(workers=workers)
        ).folder
        for workers in (None, 2)
    )

    assert_same_bytes(alone / "cases", spread / "cases")
