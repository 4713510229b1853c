"""Numbers on pages are those of the file of results, which a command takes from runs."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from benchmarks import results
from benchmarks.marks import marked_texts, outdated_texts
from benchmarks.result_texts import Results, fixed
from benchmarks.statements import STATEMENTS, joint, on_every_kind, texts_of
from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.formats.imports import GAINS


def test_pages_state_the_results_of_the_file():
    """`python -m benchmarks.results --write` changes no page."""
    texts = texts_of(results.read_results())

    outdated = [
        text
        for path in results.pages()
        for text in outdated_texts(path.read_text(), texts, path.relative_to(REPOSITORY))
    ]

    assert outdated == [], "run: python -m benchmarks.results --write"


def test_each_text_stands_on_a_page():
    """A text that no page has is computed for nobody."""
    marked = [
        text.name for path in results.pages() for text in marked_texts(path.read_text(), path)
    ]

    assert set(marked) == set(STATEMENTS)


def test_import_states_the_errors_of_the_file():
    """Its note has the errors in towers without heights, with these, and with stances."""
    table = Results(results.read_results())

    rmse = [fixed(joint(table, c, "tower").mean, 1) for c in ("no-height", "height", "noisy-walks")]

    places = [GAINS.index(f"{text} R") for text in rmse]
    assert places == sorted(places)


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Return a function that writes a page, the only one of the project."""
    path = tmp_path / "page.md"

    def write(text):
        path.write_text(text)
        return path

    monkeypatch.setattr(results, "pages", lambda: [path])
    return write


def test_the_command_writes_pages(page, capsys):
    """It names the page that changed, and does nothing the second time."""
    path = page("by <!-- results: paper-tower-rmse -->1 R<!-- end --> in towers")

    for _ in range(2):
        assert results.main(["--write"]) == 0

    text = texts_of(results.read_results())["paper-tower-rmse"]
    assert path.read_text() == f"by <!-- results: paper-tower-rmse -->{text}<!-- end --> in towers"
    assert capsys.readouterr().out == f"wrote {path}\n"


def test_the_command_refuses_a_wrong_mark(page, capsys):
    """The page stays as it is."""
    text = "\nby <!-- results: nothing -->1 R<!-- end --> in towers"
    path = page(text)

    with pytest.raises(SystemExit) as ended:
        results.main(["--write"])

    assert ended.value.code == 2
    assert f"{path}:2: nothing: there is no such text" in capsys.readouterr().err
    assert path.read_text() == text


def test_a_result_that_the_file_lacks_is_refused():
    """The message names what was looked for."""
    table = Results(results.read_results())

    with pytest.raises(InputError, match=r"^0 results of joint, height, far, rmse_R, Some CPU; "):
        table.of("joint", "height", "far", "rmse_R", "Some CPU")


def test_a_number_of_every_kind_takes_two_kinds_that_agree():
    """The README has numbers that a reader's processor gives, too."""
    columns = {
        "scenario": "joint", "condition": "height", "point": "structure.kind=tower",
        "measure": "rmse_R", "low": 0.5, "high": 0.9, "structures": 25,
    }  # fmt: skip
    rows = [columns | {"kind": f"kind {n}", "value": value} for n, value in enumerate([0.71, 0.77])]

    for number in (1, 2):
        table = Results(pd.DataFrame(rows[:number]))
        with pytest.raises(InputError, match=f"^height, tower: {number} kinds of processors have"):
            on_every_kind(table, "height", "tower")


@pytest.fixture
def run(tmp_path):
    """Folder of a run of two conditions with six structures, one of which failed."""
    folder = tmp_path / "small-1a2b3c4d"
    folder.mkdir()
    table = pd.DataFrame(
        {
            "condition": ["a"] * 6 + ["b"] * 6,
            "point": [np.nan] * 12,
            "seed": [*range(4, 10)] * 2,
            "status": ["done"] * 5 + ["failed"] + ["done"] * 6,
            "rmse_R": [1.0, 3.0, 1.0, 3.0, 2.0, np.nan] + [0.5] * 6,
        }
    )
    table.to_csv(folder / "summary.csv", index=False)
    kernels = "taichi 1.7.4, LLVM 15 for AuthenticAMD family 26 model 2 fma avx2"
    manifest = {"tiswarm": "0.2.0", "machine": {"processor": "Some CPU"}}
    manifest["numerics"] = [{"kernels": kernels}]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def test_the_command_takes_means_of_finished_cases_and_replaces_rows(run, tmp_path, capsys):
    """The same structures on the same kind of processor have one row; other kinds stay."""
    out = tmp_path / "results.csv"

    for kind in ((), ("--kind", "Other CPU"), ()):
        assert results.main([str(run), "--out", str(out), *kind]) == 0

    table = results.read_results(out)
    assert capsys.readouterr().out.splitlines()[-1] == f"{out}: 4 results"
    assert table["kind"].tolist() == ["Other CPU", "Some CPU family 26 model 2"] * 2
    assert table["value"].tolist() == [2.0, 2.0, 0.5, 0.5]
    assert table["structures"].tolist() == [5, 5, 6, 6]
    assert table["seeds"].tolist() == ["4-8", "4-8", "4-9", "4-9"]
    # The standard deviation is 1, and Student's t of four degrees of freedom 2.776.
    assert table["high"][0] - 2.0 == pytest.approx(2.776 / 5.0**0.5, abs=0.002)


def test_a_row_of_too_few_structures_has_no_interval(run, tmp_path):
    """Numbers stay numbers in the file, whose other rows do not change."""
    out = tmp_path / "results.csv"
    table = pd.read_csv(run / "summary.csv")
    table[(table["condition"] == "a") | (table["seed"] < 6)].to_csv(run / "summary.csv")

    for _ in range(2):
        assert results.main([str(run), "--out", str(out)]) == 0

    many, few = results.read_results(out).itertuples()
    assert (many.value, few.value, few.structures) == (2.0, 0.5, 2)
    assert math.isnan(few.low)
    assert math.isnan(few.high)
    assert many.high - 2.0 == pytest.approx(2.776 / 5.0**0.5, abs=0.002)


def test_a_row_counts_the_structures_that_have_its_measure(run, tmp_path):
    """Estimates that no spare measurement tests are neither consistent nor not."""
    out = tmp_path / "results.csv"
    table = pd.read_csv(run / "summary.csv")
    table["consistent"] = [1.0, np.nan, 0.0, np.nan, np.nan, np.nan] + [np.nan] * 6
    table.to_csv(run / "summary.csv", index=False)

    assert results.main([str(run), "--out", str(out)]) == 0

    counts = results.read_results(out).set_index(["condition", "measure"])["structures"]
    assert counts.to_dict() == {("a", "consistent"): 2, ("a", "rmse_R"): 5, ("b", "rmse_R"): 6}


def test_a_folder_that_is_no_run_is_refused(tmp_path, capsys):
    """Nothing is written."""
    with pytest.raises(SystemExit) as ended:
        results.main([str(tmp_path / "nothing"), "--out", str(tmp_path / "results.csv")])

    assert ended.value.code == 2
    assert "this is no finished run; give the folder of one" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


def test_shares_have_intervals_from_0_to_1(tmp_path):
    """Student's interval of 9 of 10 went on beyond all of them; Wilson's does not, in the file."""
    (tmp_path / "study-1").mkdir()
    crossed = [1.0] * 9 + [0.0]
    cases = {"seed": range(10), "condition": "a", "point": "", "status": "done", "crossed": crossed}
    pd.DataFrame(cases).to_csv(tmp_path / "study-1" / "summary.csv", index=False)
    manifest = {"tiswarm": "1", "machine": {"processor": "any"}}
    (tmp_path / "study-1" / "manifest.json").write_text(json.dumps(manifest))

    [row] = results.rows_of(tmp_path / "study-1").itertuples()

    assert (row.low, row.high) == (0.5958, 0.9821)  # by Wilson's formula at 9 of 10
    stored = results.read_results()
    shares = stored[stored["measure"].isin(["converged", "consistent", "crossed", "beyond_edge"])]
    assert shares[["low", "high"]].min(axis=None) >= 0.0
    assert shares[["low", "high"]].max(axis=None) <= 1.0
