"""Numbers on pages are those of the file of results, which a command takes from runs."""

import itertools
import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import fisher_exact

from benchmarks import results
from tests.runs import REPOSITORY
from tiswarm.evaluation.paper import PAPER as PAPER_CELLS
from tiswarm.formats.imports import GAINS

KIND = "AMD EPYC family 26 model 2"
"""Kind of processor that docs/accuracy.md names."""

ROWS = {
    "final contacts, ground, height | none": ("algorithm-1", "height"),
    "final contacts, ground | none": ("algorithm-1-no-height", "no-height"),
    "final contacts, ground, height | 1, 2 deg": ("algorithm-1-noisy", "noisy-height"),
    "walk contacts too (the default) | 1, 2 deg": ("", "noisy-walks"),
    "walk contacts and spawn positions too | 1, 2 deg": ("", "noisy-odometry"),
}
"""Conditions of Algorithm 1 and of `joint`, by the first cells of rows in docs/accuracy.md."""

OTHER = f"{KIND}, libraries without AVX2 and FMA"
"""The other kind, whose first row the page states."""

README_ROWS = ("algorithm-1", "algorithm-1-all-at-once", "height", "noisy-walks")


def _stored(condition, structure, measure="rmse_R", *, scenario="joint"):
    """Find the results of a scenario, a row for each kind of processor.

    `structure` is a kind, or settings of a structure in braces.
    """
    table = results.read_results()
    point = f"structure={structure}" if "{" in structure else f"structure.kind={structure}"
    keys = {
        "scenario": scenario, "condition": condition, "point": point, "measure": measure,
    }  # fmt: skip
    found = table[(table[list(keys)] == pd.Series(keys)).all(axis=1)]
    assert len(found) > 0, keys
    return found.set_index("kind")


def _page(*path):
    return REPOSITORY.joinpath(*path).read_text()


def _cells(page, start):
    """Split the first row of a page that starts with some cells."""
    row, *_ = [line for line in page.splitlines() if line.startswith(f"| {start} |")]
    return [cell.strip() for cell in row.strip("| ").split("|")]


def _is_rounded(text, value):
    """Whether a number on a page is a result rounded to the digits that the page has."""
    digits = len(text.partition(".")[2])
    return abs(float(text) - value) <= 0.5 * 10.0**-digits + 1e-9


def _numbers(text):
    return re.findall(r"\d*\.\d+|\d+", text)


def _on_every_kind(text, condition, structure):
    """Whether a number with one decimal is what each kind of processor gives."""
    found = _stored(condition, structure)["value"]
    return len(text.partition(".")[2]) == 1 and all(_is_rounded(text, value) for value in found)


@pytest.mark.parametrize("structure", ["tower", "cantilever"])
def test_the_readme_states_what_every_kind_of_processor_gives(structure):
    """Numbers have one decimal, and round to it on each kind that was measured."""
    text = _page("README.md")
    table = re.search(r"\| method \| measurements \|.*?\n\n", text, re.DOTALL)
    column = {"tower": 3, "cantilever": 4}[structure]

    rows = [line.strip("|").split("|") for line in table[0].strip().splitlines()[2:]]

    assert len(rows) == len(README_ROWS)
    for condition, row in zip(README_ROWS, rows, strict=True):
        assert len(_stored(condition, structure)) >= 2
        assert _on_every_kind(row[column].strip(), condition, structure), (condition, row)


def test_gains_of_the_changelog_and_of_import_are_in_the_file():
    """The first row of the changelog's table, and the note of import on what a log lacks."""
    line = _cells(_page("CHANGELOG.md"), "locate robots from a log")[1]
    of_import = re.findall(r"([\d.]+) R", GAINS)

    gains = [
        ("height", "tower"), ("height", "cantilever"), ("algorithm-1", "tower"),
        ("algorithm-1", "cantilever"), ("noisy-walks", "tower"), ("noisy-walks", "cantilever"),
    ]  # fmt: skip
    for text, gain in zip(re.findall(r"\d+\.\d+", line), gains, strict=True):
        assert _on_every_kind(text, *gain), (text, gain)
    conditions = ("no-height", "height", "noisy-walks")
    for text, condition in zip(of_import, conditions, strict=True):
        assert _on_every_kind(text, condition, "tower"), (text, condition)


@pytest.mark.parametrize("start", ROWS)
@pytest.mark.parametrize(("structure", "first"), [("tower", 2), ("cantilever", 6)])
def test_the_page_of_accuracy_has_the_file_s_results(start, structure, first):
    """RMSE and disparity of both methods, and floppy modes, of 25 structures on one kind."""
    cells = _cells(_page("docs", "accuracy.md"), start)
    assert KIND in _page("docs", "accuracy.md")

    for condition, cell in zip(ROWS[start], cells[first : first + 2], strict=True):
        names = ("rmse_R", "procrustes_disparity")
        for text, name in zip(_numbers(cell) if condition else (), names, strict=False):
            assert _is_rounded(text, _stored(condition, structure, name)["value"][KIND]), cell
        assert (cell == "-") == (not condition)
    floppy = _stored(ROWS[start][1], structure, "floppy_modes")["value"][KIND]
    assert _is_rounded(cells[first + 3], floppy)


def test_sizes_and_verdicts_of_the_page_of_accuracy_are_in_the_file():
    """Sizes of structures, intervals of the first row, and that all estimates are trusted."""
    page = _page("docs", "accuracy.md")
    sizes = {
        "contacts with earlier robots, per robot": "contacts_per_robot",
        "rms radius [R]": "rms_radius_R",
    }
    kinds = ("tower", "cantilever")

    for start, name in sizes.items():
        for text, structure in zip(_cells(page, start)[1:], kinds, strict=True):
            assert _is_rounded(text, _stored("height", structure, name)["value"][KIND])
    intervals = re.search(r"intervals of ± ([\d.]+) R \(tower\) and ± ([\d.]+) R", page)
    for stated, structure in zip(intervals.groups(), kinds, strict=True):
        row = _stored("height", structure).loc[KIND]
        assert _is_rounded(stated, (row["high"] - row["low"]) / 2)
    text = " ".join(page.split())  # lines may break anywhere
    number = r"(\d*\.\d+)"
    others = re.search(
        rf"neither AVX2 nor FMA, .*?: {number} and {number}, {number} and {number}\.", text
    )
    cells = itertools.product(kinds, ("algorithm-1", "height"))
    for stated, (structure, condition) in zip(others.groups(), cells, strict=True):
        assert _is_rounded(stated, _stored(condition, structure)["value"][OTHER])
    assert "All 250 estimates of 25 structures" in text
    for (_, condition), structure in ((c, s) for c in ROWS.values() for s in kinds):
        for name in ("converged", "consistent"):
            assert _stored(condition, structure, name)["value"][KIND] == 1.0


CONDITIONS = ("all-cues", "no-z", "no-z-no-undock")
"""Conditions of the paper's table, in the order of its cells."""

PAPER = {
    "tower": "tower, recruit_base: 1.5",
    "cantilever": "cantilever, recruit_base: 1.5, anchor: 6.5, founders: 2",
}
"""Structures of the scenario paper."""

PAPER_SETS = {
    "J = 1, 5 R": (
        "tower, recruit_limit: 1",
        "cantilever, recruit_limit: 1, anchor: 5.0, founders: 2",
    ),
    "F = 17, 5 R": (
        "tower, force_threshold: 17.0",
        "cantilever, force_threshold: 17.0, anchor: 5.0, founders: 2",
    ),
    "F = 10, 6.5 R: tiswarm's defaults": ("tower", "cantilever, anchor: 6.5, founders: 2"),
    "F = 3.5, 5 R, `placed`": (
        "tower, force_threshold: 3.5",
        "cantilever, force_threshold: 3.5, anchor: 5.0, founders: 2, spawn_behind: placed",
    ),
}
"""Structures of the scenario paper-sets: towers and cantilevers, as docs/paper.md names them."""


def _of_paper(kind, condition, measure, scenario="paper"):
    rows = _stored(condition, f"{{kind: {kind}}}", measure, scenario=scenario)
    return rows.loc[KIND]


def test_the_page_of_the_paper_has_the_file_s_results():
    """Means and intervals of RMSE and disparity: two kinds in three conditions."""
    page = _page("docs", "paper.md")
    table = re.search(r"\| \| paper: RMSE, d \|.*?\n\n", page, re.DOTALL)[0].splitlines()[2:]

    for line, (kind, condition) in zip(
        filter(None, table), itertools.product(PAPER, CONDITIONS), strict=True
    ):
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        assert cells[0].startswith(kind)
        for cell, measure in ((cells[2], "rmse_R"), (cells[6], "procrustes_disparity")):
            row = _of_paper(PAPER[kind], condition, measure)
            mean, half = _numbers(cell)[:2]
            assert _is_rounded(mean, row["value"]), line
            assert _is_rounded(half, (row["high"] - row["low"]) / 2), line


def test_the_page_of_the_paper_states_what_its_structures_are():
    """Heights, reach and robots beyond the edge, by kind."""
    page = _page("docs", "paper.md")
    tower, cantilever = (
        _cells(page, start) for start in ("tower | 65 R up", "cantilever | 45 R out")
    )

    assert _is_rounded(tower[2], _of_paper(PAPER["tower"], "all-cues", "height_R")["value"])
    reach, beyond = (
        _of_paper(PAPER["cantilever"], "all-cues", name)["value"]
        for name in ("reach_R", "beyond_edge")
    )
    assert _is_rounded(cantilever[2], reach)
    assert _is_rounded(_numbers(cantilever[3])[0], 100.0 * beyond)


@pytest.mark.parametrize("name", PAPER_SETS)
def test_other_sets_of_the_paper_have_the_file_s_ratios(name):
    """Six ratios of RMSE in rho, six of the disparity, and the mean factor off."""
    cells = _cells(_page("docs", "notes", "anchor-gap.md"), name)
    reach, height = _numbers(cells[5])
    tower, cantilever = PAPER_SETS[name]
    ratios = []
    for cell, measure, unit in ((6, "rmse_R", 1.506), (7, "procrustes_disparity", 1.0)):
        published = [
            each.rmse_radii if measure == "rmse_R" else each.disparity
            for each in PAPER_CELLS.values()
        ]
        ours = [
            _of_paper(kind, condition, measure, "paper-sets")["value"] / unit
            for kind in (tower, cantilever)
            for condition in CONDITIONS
        ]
        found = [a / b for a, b in zip(ours, published, strict=True)]
        stated = re.findall(r"\d*\.\d+", cells[cell])
        # Means are stored with four digits.
        assert all(abs(float(s) - f) < 0.006 for s, f in zip(stated, found, strict=True))
        ratios += found
    factor = math.exp(sum(abs(math.log(ratio)) for ratio in ratios) / len(ratios))
    assert abs(factor - float(_numbers(cells[8])[0])) < 0.006
    for kind, measure, stated in ((tower, "height_R", height), (cantilever, "reach_R", reach)):
        assert _is_rounded(stated, _of_paper(kind, "all-cues", measure, "paper-sets")["value"])


@pytest.mark.parametrize(
    ("start", "force", "anchor"),
    [
        ("F = 3.5", 3.5, 6.5), ("F = 5", 5.0, 6.5), ("F = 10, the chosen set", None, 6.5),
        ("F = 17", 17.0, 6.5), ("F = 25", 25.0, 6.5), ("F = 10, anchor at 2 R", None, 2.0),
        ("F = 10, anchor at 3.5 R", None, 3.5), ("F = 10, anchor at 5 R", None, 5.0),
    ],
)  # fmt: skip
def test_the_note_on_the_gap_has_the_file_s_errors(start, force, anchor):
    """Mean RMSE with all cues."""
    cells = _cells(_page("docs", "notes", "anchor-gap.md"), start)
    called = "" if force is None else f"force_threshold: {force}, "
    point = f"{{kind: cantilever, {called}recruit_base: 1.5, anchor: {anchor}, founders: 2}}"
    assert _is_rounded(cells[2], _of_gap(point)["value"][KIND])


def _of_gap(point):
    return _stored("all-cues", point, scenario="anchor-gap")


BY = {
    "the truth": ("truth", "online"),
    "`online`": ("estimate", "online"),
    "own messages": ("estimate", "messages"),
    "Algorithm 1": ("estimate", "algorithm-1"),
}
BUILT = {
    "towers": "{kind: tower}",
    "cantilevers": "{kind: cantilever}",
    "bridges over 20 R": "{kind: bridge, gap: 20.0}",
    "bridges over 30 R": "{kind: bridge, gap: 30.0}",
}
"""Structures of the scenario closed-loop, as its page names them."""


def _built(kind, by, measure):
    """Return the result of a kind of structure, by what its robots navigate by."""
    navigate, condition = BY[by]
    point = f"structure={BUILT[kind]}, structure.navigate_by={navigate}"
    found = results.read_results()
    keys = {"scenario": "closed-loop", "condition": condition, "point": point, "measure": measure}
    # Final answers of bridges by own messages are of another kind of processor.
    [row, *_] = sorted(
        found[(found[list(keys)] == pd.Series(keys)).all(axis=1)].to_dict("records"),
        key=lambda row: row["kind"] != KIND,
    )
    return row


@pytest.mark.parametrize("by", BY)
def test_the_page_of_closed_loops_has_what_robots_build(by):
    """Heights and reaches with intervals, bridges that close, and p against the truth."""
    height, reach, *bridges = _cells(_page("docs", "guides", "closed-loop.md"), by)[1:]
    for cell, kind, measure in ((height, "towers", "height_R"), (reach, "cantilevers", "reach_R")):
        found, (mean, half) = _built(kind, by, measure), _numbers(cell)
        assert _is_rounded(mean, found["value"])
        assert _is_rounded(half, (found["high"] - found["low"]) / 2)
        assert found["structures"] == 64
    for cell, kind in zip(bridges, [*BUILT][2:], strict=True):
        closed, truth = (_built(kind, each, "crossed")["value"] for each in (by, "the truth"))
        assert cell.startswith(f"{round(64 * closed)} of 64")
        if by != "the truth":
            stated = float(cell.partition("p = ")[2].rstrip(")"))
            assert stated == pytest.approx(_p_against(closed, truth), rel=0.06)


@pytest.mark.parametrize("kind", BUILT)
def test_the_page_of_closed_loops_has_tries_errors_and_bytes(kind):
    """Tries and flips of each kind of structure; errors of beliefs, and bytes sent for them."""
    note = _page("docs", "notes", "measurements.md")
    tries, errors = note.split("| structures, by what robots go by")[1:]
    flips = [("tries_per_robot", 1.0), ("failed_flips", 1.0), ("flips_as_planned", 100.0)]
    beliefs = [(f"belief_{name}_R", 1.0) for name in ("building", "newest", "final", "per_contact")]
    beliefs += [("rmse_R", 1.0)]
    beliefs += [(f"belief_{name}_B", 1e-3) for name in ("sent", "worst_sent")]
    for table, measures in ((tries, flips), (errors, beliefs)):
        for by in BY:
            if by == "the truth" and measures is beliefs:
                continue
            cells = _cells(table, f"{kind}, {by}")[1:]
            for cell, (measure, unit) in zip(cells, measures, strict=False):
                if cell.strip():
                    assert _is_rounded(_numbers(cell)[0], unit * _built(kind, by, measure)["value"])


def _p_against(closed, others, count=64):
    """Compute p of Fisher's exact test for two shares of as many bridges."""
    numbers = [round(count * float(share)) for share in (closed, others)]
    return fisher_exact([[number, count - number] for number in numbers]).pvalue


def test_the_page_of_closed_loops_has_the_file_s_bridges_by_kind_of_error():
    """RMSE, error between neighbors, bridges that closed, p and tries, of each kind and size."""
    page = _page("docs", "notes", "measurements.md").partition("## Which errors cost bridges")[2]
    page = page.partition("## ")[0]
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    rows = [row for row in rows if len(row) == 7 and row[1][0].isdigit()]
    assert len(rows) == 12

    def stored(settings, measure):
        point = f"{{kind: bridge, gap: 30.0{settings}}}"
        return _stored("baseline", point, measure, scenario="belief-errors")["value"][KIND]

    truth = stored("", "crossed")
    for kind, size, rmse, between, closed, p, tries in rows:
        error = (
            f", navigate_by: error, belief_error: {{kind: {kind}, size: {float(size.split()[0])}}}"
        )
        assert _is_rounded(rmse, stored(error, "belief_final_R"))
        assert _is_rounded(between, stored(error, "belief_per_contact_R"))
        assert int(_numbers(closed)[0]) == round(64 * stored(error, "crossed"))
        assert float(p) == pytest.approx(_p_against(stored(error, "crossed"), truth), rel=0.06)
        assert _is_rounded(tries, stored(error, "tries_per_robot"))


OF_LOSSES = "AMD EPYC family 25 model 17"
"""Kind of processor of the table of losses."""

MESSAGES = {
    "`joint`, whole log": "joint",
    "default, by touch": "touch",
    "`base`, by touch": "base",
    "by radio, seeds 0 to 9": "radio",
    "Algorithm 1 by radio, poses at each join": "algorithm-1",
    "Algorithm 1 by touch, no undocked repulsion": "algorithm-1-local",
}
"""Conditions of `between`, by the first cells of rows in docs/guides/distributed.md."""


@pytest.mark.parametrize("start", MESSAGES)
def test_the_page_of_messages_has_the_file_s_errors_and_costs(start):
    """Errors, bytes and rounds of both structures, with intervals where the page has them."""
    cells = _cells(_page("docs", "guides", "distributed.md"), start)[1:]
    names = ["rmse_R", "rmse_per_contact_R", "sent_B", "worst_sent_B", "worst_memory_B", "rounds"]

    for name, cell in zip(names, cells, strict=False):  # the last ones may be empty
        both = cell.split(", ") if cell else ()
        for stated, structure in zip(both, ("tower", "cantilever"), strict=bool(cell)):
            found = _stored(MESSAGES[start], structure, name, scenario="between").loc[KIND]
            unit = 1000.0 if name.endswith("_B") else 1.0
            mean, *half = _numbers(stated.replace(",", ""))
            if name == "rounds":
                assert abs(float(mean) - found["value"]) <= 5.0  # the page has three digits
                continue
            assert _is_rounded(mean, found["value"] / unit), name
            for each in half:
                assert _is_rounded(each, (found["high"] - found["low"]) / 2 / unit), name


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


def test_a_folder_that_is_no_run_is_refused(tmp_path, capsys):
    """Nothing is written."""
    with pytest.raises(SystemExit) as ended:
        results.main([str(tmp_path / "nothing"), "--out", str(tmp_path / "results.csv")])

    assert ended.value.code == 2
    assert "this is no finished run; give the folder of one" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


LOSSES = {
    f"{lost}, {structure}s": (condition, structure)
    for structure in ("tower", "cantilever")
    for lost, condition in {
        "0 %": "touch",
        **{f"{k} %": f"touch-loss-{k}" for k in (10, 20, 30)},
        "30 % in bursts": "touch-bursts",
    }.items()
}
"""Conditions and structures by the first cells of rows in docs/guides/distributed.md."""


@pytest.mark.parametrize("start", LOSSES)
def test_the_page_of_messages_has_the_file_s_losses(start):
    """Errors and bytes with their intervals, of the kind of processor that the page names."""
    cells = _cells(_page("docs", "guides", "distributed.md"), start)[1:]
    names = ["rmse_R", "rmse_per_contact_R", "sent_B", "worst_sent_B", "rounds"]
    for name, cell in zip(names, cells, strict=False):  # then come robots that doubt
        found = _stored(*LOSSES[start], name, scenario="between").loc[OF_LOSSES]
        if name == "rounds":
            assert abs(float(cell.replace(",", "")) - found["value"]) <= 5.0
            continue
        unit = 1000.0 if name.endswith("_B") else 1.0
        mean, *half = _numbers(cell)
        assert _is_rounded(mean, found["value"] / unit), name
        for each in half:
            assert _is_rounded(each, (found["high"] - found["low"]) / 2 / unit), name


CHANNELS = {
    "touch": "touch",
    "touch, 30 % lost": "touch-loss-30",
    "touch, 30 % lost in bursts of 8 rounds": "touch-bursts",
    "touch, delay of 5 rounds": "touch-delay",
    "radio, all in reach": "radio",
    "radio, 8 R": "radio-8-R",
    "radio, 8 R, 30 % lost": "radio-8-R-loss-30",
    "radio, 8 R, 30 % lost in bursts of 8 rounds": "radio-8-R-bursts",
    "radio, 8 R, 16 slots": "radio-8-R-slots",
    "radio, all in reach, poses of all at each join": "algorithm-1",
    "the same, 30 % lost": "algorithm-1-loss-30",
    "the same, 30 % lost in bursts of 8 rounds": "algorithm-1-bursts",
    "the same, 16 slots": "algorithm-1-slots",
    "radio, 8 R, poses if asked": "algorithm-1-asked",
    "that, 30 % lost": "algorithm-1-asked-loss-30",
    "that, 30 % lost in bursts of 8 rounds": "algorithm-1-asked-bursts",
    "that, 16 slots": "algorithm-1-asked-slots",
    "touch, no undocked repulsion": "algorithm-1-touch",
}
"""Conditions of `channels`, by the first cells of rows in docs/guides/distributed.md."""


@pytest.mark.parametrize("start", CHANNELS)
def test_the_page_of_messages_has_the_file_s_channels(start):
    """Errors with their intervals, bytes and rounds."""
    cells = _cells(_page("docs", "guides", "distributed.md"), start)[1:]
    if CHANNELS[start].startswith("algorithm-1"):
        del cells[1]  # p
    table = results.read_results()
    rows = table[(table["scenario"] == "channels") & (table["condition"] == CHANNELS[start])]
    found = rows.set_index("measure")

    error, half = _numbers(cells[0])
    assert _is_rounded(error, found.loc["rmse_R", "value"])
    assert _is_rounded(half, (found.loc["rmse_R", "high"] - found.loc["rmse_R", "low"]) / 2)
    for name, cell in (("sent_B", cells[1]), ("worst_sent_B", cells[2])):
        assert _is_rounded(cell, found.loc[name, "value"] / 1e3), name
    for cell in filter(None, cells[3:]):
        assert abs(float(cell.replace(",", "")) - found.loc["rounds", "value"]) <= 5.0
