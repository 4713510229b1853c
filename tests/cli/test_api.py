"""`tiswarm.run` gives a notebook what the command writes."""

import html
import inspect
import io
import re
import shutil
import subprocess
import sys
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml

import tiswarm as library
from tests.runs import REPOSITORY, assert_same_bytes, assert_same_results
from tiswarm.base.errors import InputError

SMALL = {"robots": 12, "seeds": 2}
"""Settings of the small run."""


@pytest.fixture(scope="module")
def run(small_run):
    """Two towers under three conditions, which the command ran."""
    return library.open_run(small_run)


def test_tables_are_data_frames(run):
    """Results by condition, by case and of one case are those of the files."""
    assert list(run.summary["status"]) == ["done"] * 6
    assert run.table["rmse_R_mean"].notna().all()
    assert len(run.frame("estimate", case=run.summary["case"][0])) == 12
    full = pd.read_csv(run.folder / "table.csv")
    pd.testing.assert_frame_equal(run.frame("table"), full)
    table = run.table
    assert {"condition", "cases", "rmse_R_least"} < {*table}
    assert len(table.columns) < 40
    pd.testing.assert_frame_equal(table.iloc[:, 1:], full[[*table][1:]])
    assert table["series"].tolist() == run.paper_table()["condition"].tolist()


def test_a_run_without_a_finished_case_has_no_table_for_a_paper(run, tiswarm, tmp_path):
    """The names of conditions alone would look like a table."""
    folder = tmp_path / "failed"
    shutil.copytree(run.folder, folder)
    table = pd.read_csv(folder / "table.csv")
    table.assign(cases=0, failed=3).to_csv(folder / "table.csv", index=False)

    done = tiswarm("table", folder)

    assert (done.returncode, done.stdout) == (2, "")
    assert f"{folder}: no case of this run is done; correct the scenario" in done.stderr


def test_a_table_for_a_paper_is_that_of_the_page(run, tiswarm):
    """Three forms have the same cells; few structures have ranges, and no interval."""
    cells = run.paper_table()
    latex, markdown, csv = (
        tiswarm("table", run.folder, form).stdout for form in ("--latex", "--markdown", "--csv")
    )

    assert [*cells] == ["condition", "n", "RMSE [R]", "disparity"]
    assert cells["RMSE [R]"].str.fullmatch(r"[\d.]+ \([\d.]+ to [\d.]+\)").all()
    pd.testing.assert_frame_equal(pd.read_csv(io.StringIO(csv), dtype=str, na_filter=False), cells)
    for rmse in cells["RMSE [R]"]:
        assert rmse in latex
        assert f"| {rmse} |" in markdown
    assert latex.count(r"\\") == 1 + len(cells)
    assert r"\toprule" in latex
    assert tiswarm("table", run.folder, "--latex", "--csv").returncode == 2
    page = run.page.read_text()
    assert all(f">{rmse.partition(' ')[0]} <" in page for rmse in cells["RMSE [R]"])
    with pytest.raises(InputError, match=r"^name: .* choose one of .*summary, table"):
        run.frame("nothing")
    with pytest.raises(InputError, match=r"^case: .* choose one of 0-baseline"):
        run.frame("estimate", case="nothing")


def test_a_run_is_opened_later(run):
    """The folder is all that a notebook needs; it shows a link to the page and the errors."""
    again = library.open_run(str(run.folder))

    assert again == run
    assert f'<a href="{run.folder}/report.html">' in again._repr_html_()
    assert "<td>baseline" in again._repr_html_()
    with pytest.raises(InputError, match="is no run folder"):
        library.open_run(run.folder / "cases")


def test_figures_show_themselves(run):
    """A notebook asks for the bytes of a picture."""
    assert {"convergence", "accuracy"} <= set(run.figures)
    assert run.figures["convergence"]._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(
        InputError, match=r"^name: there is no 'convergance'; choose .* did you mea"
    ):
        run.figures["convergance"]


def test_a_figure_can_be_changed_and_saved(run, tmp_path):
    """Who writes a paper has a style of their own."""
    figure = run.figure("accuracy")

    figure.axes[0].set_xlabel("Error [R]")
    figure.savefig(tmp_path / "mine.svg")

    assert "Error [R]" in (tmp_path / "mine.svg").read_text().replace("<!-- ", "")
    with pytest.raises(InputError, match=r"^name: there is no figure 'error'; choose one of conv"):
        run.figure("error")


def test_a_figure_fits_a_column_of_a_paper(run, tiswarm, tmp_path):
    """The command and the call draw the panels that a reader names, in any width."""
    file = tmp_path / "column.pdf"
    command = ("figure", run.folder, "accuracy", "--width", "3.5", "--out")

    done = tiswarm(*command, file, "--panel", "rmse_R")
    again = tiswarm(*command, file, "--panel", "rmse_R")
    wrong = tiswarm(*command, tmp_path / "other.png", "--panel", "rmse")

    assert (done.returncode, done.stdout) == (0, f"{file}\n")
    size = file.read_bytes().partition(b"/MediaBox [")[2]
    assert float(size.split()[2]) == 72 * 3.5
    assert (again.returncode, wrong.returncode) == (2, 2)
    assert "there is no 'rmse'; choose one of rmse_R, procrustes_disparity" in wrong.stderr
    assert [*tmp_path.iterdir()] == [file]
    figure = run.figure("accuracy", panels=["rmse_R"], width=3.5)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), figure.get_figwidth()) == ("RMSE [R]", 3.5)
    alone = figure.subfigures().subplots()
    run.draw_panel(alone, "accuracy", "procrustes_disparity")
    assert alone.get_xlabel() == "Procrustes disparity"


@pytest.mark.parametrize("name", ["read_log", "open_run", "localize", "view"])
def test_what_is_no_path_is_refused(name):
    """A dictionary in place of a file is a mistake of the caller, not of `pathlib`."""
    with pytest.raises(InputError, match="a value of type dict is no file; give the path of one"):
        getattr(library, name)({"name": "tower"})


@pytest.mark.parametrize("pictures", [False, pytest.param(True, marks=pytest.mark.trial)])
def test_a_call_writes_what_the_command_writes(run, tmp_path, pictures):
    """Same scenario, same folder, same bytes."""
    again = library.run("tests/tower.yaml", SMALL, out=tmp_path, pictures=pictures, quiet=True)

    assert again.folder.name == run.folder.name
    compare = assert_same_results if pictures else assert_same_bytes
    compare(run.folder, again.folder)


def test_numbers_of_numpy_are_plain_numbers(run):
    """A scenario changed by them is the same scenario; a finished run is found."""
    overrides = {"robots": np.int64(12), "seeds": np.uint8(2)}

    again = library.run("tests/tower.yaml", overrides, out=run.folder.parent, quiet=True)

    assert again.folder == run.folder


@pytest.mark.filterwarnings("ignore:not converged")  # so few steps
def test_settings_of_numpy_are_plain_numbers(run):
    """A log is localized by the same settings; anything that is no plain data is refused."""
    log = run.folder / "cases" / "0-baseline" / "sensing.jsonl"

    found = library.localize(
        log, "virtual-force", iterations=np.int64(5), height_gain=np.float32(1)
    )

    expected = library.localize(log, "virtual-force", iterations=5, height_gain=1.0)
    np.testing.assert_array_equal(found.position, expected.position)
    with pytest.raises(InputError, match="iterations: is of type object"):
        library.localize(log, "virtual-force", iterations=object())


def test_joint_is_the_default_method(run):
    """Of the methods it is the most accurate."""
    log = run.folder / "cases" / "0-baseline" / "sensing.jsonl"
    quick = {"chains": 1, "steps": 1000}

    found = library.localize(log, **quick)

    expected = library.localize(log, "joint", **quick)
    np.testing.assert_array_equal(found.position, expected.position)


def test_failed_cases_are_warned_of(tmp_path):
    """What is done is kept; nobody overlooks what is not."""
    far = {"spawn_min": 300, "spawn_max": 310, "climb.max_flips": 2, "climb.max_spawns": 2}
    impossible = SMALL | {f"structure.{key}": value for key, value in far.items()}

    with pytest.warns(UserWarning, match="6 cases failed, the first: 0-"):
        run = library.run("tests/tower.yaml", impossible, out=tmp_path, quiet=True)

    assert set(run.summary["status"]) == {"failed"}


@pytest.mark.trial
def test_a_log_is_localized_without_the_simulator(run):
    """Neither world nor sensing is imported for the log of another simulator."""
    log = run.folder / "cases" / "0-baseline" / "sensing.jsonl"
    code = (
        "import sys, tiswarm; tiswarm.localize(sys.argv[1], 'virtual-force', iterations=5);"
        "print(sorted(name for name in sys.modules if name.startswith('tiswarm.')))"
    )

    done = subprocess.run(
        [sys.executable, "-c", code, log], capture_output=True, text=True, check=True
    )

    assert "tiswarm.localization.methods" in done.stdout
    assert not re.search(r"tiswarm\.(world|sensing|study|report)", done.stdout)


@pytest.mark.filterwarnings("ignore:not converged")  # so few steps
def test_an_estimate_is_scored_and_shown(run, tmp_path):
    """As an object as well as by its table."""
    case = run.folder / "cases" / "0-baseline"
    log = library.read_log(case / "sensing.jsonl")
    estimate = library.localize(log, "virtual-force")

    page = library.view(log, estimate, case / "truth.csv", out=tmp_path / "view.html")
    rmse = library.score(case / "truth.csv", estimate)["RMSE"]

    frame = run.frame("estimate", case="0-baseline")
    pd.testing.assert_frame_equal(estimate.to_frame(), frame)
    assert rmse == library.score(case / "truth.csv", case / "estimate.csv")["RMSE"]
    assert f"RMSE is {rmse:.3g} R" in page.read_text()
    advised = library.advise(log, estimate).to_frame()
    assert set(advised["rank"]) <= {*range(1, 10)}
    assert advised["floppy modes removed"].ge(0).all()  # numbers, not words
    assert len(library.advise(log, estimate, budget=2).together.to_frame()) == 2
    with pytest.raises(InputError, match="estimate: is in mm, the truth in R"):
        library.score(case / "truth.csv", replace(estimate, length_unit="mm"))


@pytest.mark.filterwarnings("ignore:not converged")  # so few steps
def test_results_print_what_commands_print(run, tiswarm, tmp_path):
    """A notebook shows the words of the command: they stand in one place."""
    case = run.folder / "cases" / "0-baseline"
    log, table = case / "sensing.jsonl", tmp_path / "estimate.csv"
    quick = {"method": "virtual-force", "iterations": 5}

    estimate = library.localize(log, **quick)
    estimate.write(table)
    first, *reasons = str(estimate).splitlines()
    called = {
        ("check", log): f"{log}: {library.check(log)}",
        (
            "localize",
            log,
            "--method=virtual-force",
            "--set=iterations=5",
            f"--out={table}",
            "--overwrite",
        ): "\n".join([f"{first} -> {table}", *reasons]),
        ("advise", log, table): library.advise(log, table),
        ("score", case / "truth.csv", table): library.score(case / "truth.csv", estimate),
    }

    for command, result in called.items():
        assert tiswarm(*command).stdout == f"{result}\n"


@pytest.mark.filterwarnings("ignore:not converged")  # so few steps
def test_methods_write_what_calls_write(run, tmp_path):
    """A log, an estimate and a run show themselves by the code that shows files."""
    case = run.folder / "cases" / "0-baseline"
    log, truth = library.read_log(case / "sensing.jsonl"), case / "truth.csv"
    estimate = log.localize("virtual-force", iterations=5)
    by_call, by_method = tmp_path / "call", tmp_path / "method"

    library.view(case / "sensing.jsonl", estimate, truth, out=tmp_path / "call.html")
    library.export(log, "csv", estimate, truth, out=by_call, quiet=True)
    library.export(run.folder, "ply", out=by_call / "run", quiet=True)
    estimate.view(truth, out=tmp_path / "method.html")
    estimate.export("csv", truth, out=by_method, quiet=True)
    run.export("ply", out=by_method / "run", quiet=True)

    assert (tmp_path / "method.html").read_bytes() == (tmp_path / "call.html").read_bytes()
    assert_same_results(by_call, by_method)
    assert estimate.log is log
    assert library.view(run) == run.view() == run.folder / "report.html"


def test_a_notebook_shows_the_page_that_view_returns(run, tmp_path):
    """The page stands within the cell, whole, so that a saved notebook has it too."""
    page = library.view(run)

    shown = page._repr_html_()

    assert html.unescape(re.search(r'srcdoc="([^"]*)"', shown)[1]) == page.read_text()
    assert page.parent._repr_html_() is None  # a folder is shown as any path


def test_a_dictionary_runs_as_its_file_does(run, tmp_path):
    """Same checks, same folder and same bytes; the caller's dictionary stays as it is."""
    scenario = yaml.safe_load((REPOSITORY / "tests" / "tower.yaml").read_text())
    given = deepcopy(scenario)

    again = library.run(given, SMALL, out=tmp_path, pictures=False, quiet=True)

    assert again.folder.name == run.folder.name
    assert (again.folder / "summary.csv").read_bytes() == (run.folder / "summary.csv").read_bytes()
    assert given == scenario


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"robotss": 3}, "^robotss: .*did you mean robots"),
        ({"structure": {"kind": "towr"}}, "^structure.kind: .*towr"),
        ({"robots": object()}, "^robots: .*give numbers, strings, lists or dictionaries"),
    ],
)
def test_a_mistake_in_a_dictionary_names_its_key(changes, problem):
    """In the words that a file gets, without a line."""
    scenario = yaml.safe_load((REPOSITORY / "tests" / "tower.yaml").read_text())

    with pytest.raises(InputError, match=problem):
        library.run(scenario | changes)


def test_a_dictionary_is_checked_as_a_file_is():
    """With overrides, too; a log has none."""
    scenario = yaml.safe_load((REPOSITORY / "tests" / "tower.yaml").read_text())

    found = library.check(scenario, {"robots": 1, "seedss": 2})

    assert [mistake.key for mistake in found.mistakes] == ["seedss=2", "robots=1"]
    assert not library.check(scenario, ["robots=4"]).mistakes
    with pytest.raises(InputError, match=r"^sensing\.jsonl: is a log, which has no keys"):
        library.check("sensing.jsonl", ["robots=4"])


def test_a_comparison_prints_its_table(run, tmp_path):
    """A row for each run and condition; the whole tables stand in files."""
    smaller = library.run(
        "tests/tower.yaml", SMALL | {"robots": 4}, out=tmp_path, pictures=False, quiet=True
    )

    found = library.compare(run, smaller, out=tmp_path)

    printed = str(found).splitlines()
    assert printed[0].split()[:2] == ["run", "condition"]
    assert sum(run.folder.name in line for line in printed) == len(run.table)
    assert max(map(len, printed[:-2])) < 100
    assert "comparison.csv" in printed[-2]
    assert printed[-1] == f"open {found.page}"
    assert found._repr_html_().count("<tr") == 1 + len(found.table)


@pytest.mark.filterwarnings("ignore:not converged")  # so few steps
def test_large_objects_have_short_names(run):
    """A notebook shows no wall of arrays."""
    log = library.read_log(run.folder / "cases" / "0-baseline" / "sensing.jsonl")
    estimate = library.localize(log, "virtual-force", iterations=5)

    assert re.fullmatch(
        r"SensingLog\(12 robots, \d+ contacts, \d+ stances, lengths in R\)", repr(log)
    )
    stated = "the method states no error of the positions of 12 robots; not converged"
    assert repr(estimate) == f"Estimate({stated})"
    assert "array" not in repr(estimate.observability)


def test_commands_are_calls(run, tmp_path):
    """Each writes or returns what its command does."""
    exported = library.export(run, "csv", out=tmp_path, quiet=True)
    checked = library.check(run.folder / "cases" / "0-baseline" / "sensing.jsonl")
    poses = "scenarios/examples/foreign-poses.csv"
    imported = library.import_poses(poses, dock_radius=0.5, out=tmp_path / "imported")

    assert {path.name for path in exported.iterdir()} >= {"structure.csv", "estimate.csv"}
    assert checked.summary.startswith("12 robots")
    assert not checked.mistakes
    assert imported[""].log.robot_count == 36
    assert library.read_log(tmp_path / "imported" / "sensing.jsonl").robot_count == 36
    with pytest.raises(InputError, match="there is no 'dock_ofset'; choose one of dock_radius"):
        library.import_poses(poses, dock_ofset=1.0)


def test_pictures_and_exports_of_a_log_need_no_run(run, tmp_path):
    """As the commands do: of the log's file or object, with its estimate."""
    case = run.folder / "cases" / "0-baseline"
    log, estimate = library.read_log(case / "sensing.jsonl"), case / "estimate.csv"
    (tmp_path / "renders").mkdir()
    (tmp_path / "renders" / "older.png").touch()

    exported = library.export(log, "ply", estimate, case / "truth.csv", out=tmp_path, quiet=True)
    log_file, place = case / "sensing.jsonl", tmp_path / "renders"
    drawn = library.export(log_file, "png", estimate, out=place, quiet=True)

    assert {"structure.ply", "estimate.ply"} <= {path.name for path in exported.iterdir()}
    assert {path.stem for path in drawn.glob("*.png")} == {"estimate", "contact-graph", "older"}
    assert (drawn / "estimate.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="case: a log is no run; leave it out"):
        library.export(log, "ply", estimate, case="0-baseline")
    with pytest.raises(
        InputError, match=r"estimate: a run has its own \(sensing.jsonl of a case takes others\)"
    ):
        library.export(run, "png", estimate)


def test_the_calls_are_listed():
    """Completion and help find them, though they are imported late; help explains each."""
    names = dir(library)

    assert {"run", "open_run", "localize", "score", "view", "advise", "Localizer"} <= {*names}
    assert all(getattr(library, name).__doc__ for name in {*names} - {"ti"})  # Taichi's module
    for name in ("run", "open_run", "localize", "score", "view", "advise", "check", "relax"):
        assert f"\n    {name}\n" in f"{library.__doc__}\n"


def test_no_signature_spells_out_what_numpy_takes():
    """Types of arrays have one name in `help`, whatever they stand for."""
    public = [getattr(library, name) for name in library.__all__]
    calls = [call for call in public if callable(call) and not isinstance(call, type)]

    signatures = [str(inspect.signature(call)) for call in calls]

    assert [text for text in signatures if "numpy._typing" in text] == []
    assert len(str(inspect.signature(library.relax))) < 800
