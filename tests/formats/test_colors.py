"""Values of a user's table color robots on pages, in pictures and in exports."""

import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tiswarm
from tests.browser import probe
from tiswarm.base.errors import InputError
from tiswarm.formats.colors import colored, read_colorings
from tiswarm.report.figure_style import LABEL_COLORS, SCALES, UNKNOWN_GRAY, rgb
from tiswarm.report.pictures.pictures import build_pictures
from tiswarm.report.pictures.scene import paint
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import Coloring, build_view, read_case_view, view_log

TABLE = """robot;charge [V];role
0;11,5;scout
2;12,25;relay
1;10;scout
3;;carrier
"""
"""Of five robots, the last one has no row, and robot 3 no charge."""


@pytest.fixture
def table(tmp_path, monkeypatch):
    """Work beside a table."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "values.csv").write_text(TABLE)
    return "values.csv"


@pytest.fixture
def estimate(small_run):
    """Estimate of twelve robots."""
    case = small_run / "cases/0-baseline"
    return tiswarm.read_log(case / "sensing.jsonl").with_estimate(case / "estimate.csv")


def test_numbers_and_labels_are_read_in_join_order(table):
    """The header has the unit; robots without a value are unknown."""
    charge, role = read_colorings([f"{table}:charge", f"{table}:role"], np.arange(5))

    assert charge.title == "charge [V]"
    assert charge.value[:3].tolist() == [11.5, 10.0, 12.25]
    assert np.isnan(charge.value[3:]).all()
    assert charge.least == 10.0
    assert role.words == ["scout", "relay", "carrier"]
    assert role.value[:4].tolist() == [0.0, 0.0, 1.0, 2.0]
    assert np.isnan(role.value[4])


def test_series_of_pandas_are_read_as_tables(table):
    """Notebooks have values at hand."""
    series = pd.Series([11.5, 10.0, 12.25], index=[0, 1, 2], name="charge [V]")

    [one], [other] = (read_colorings(each, np.arange(5)) for each in (f"{table}:charge", series))

    assert one[:2] == other[:2]
    assert np.array_equal(one.value, other.value, equal_nan=True)


@pytest.mark.parametrize(
    "cells",
    [
        ["01", "02", "01"],
        ["1.10", "1.9", "1.1"],
        ["2026-11-28", "2026-11-29", "2026-11-28"],
        ["28.11.2026", "29.11.2026", "1.12.2026"],
        ["9007199254740993", "9007199254740992", "1"],
        ["3rd", "1st", "2nd"],
        ["1", "007", "7"],
    ],
)
def test_labels_of_digits_stay_labels(cells, tmp_path, monkeypatch):
    """Codes, versions, dates and long numbers: as numbers some would be equal, or others."""
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{robot},{cell}\n" for robot, cell in enumerate(cells))
    (tmp_path / "values.csv").write_text(f"robot,code\n{rows}")

    [code] = read_colorings("values.csv:code", np.arange(3))

    assert [code.words[int(value)] for value in code.value] == cells


@pytest.mark.parametrize(
    "cells", [["1.10", "2.25"], ["1.0", "2.25"], ["-.5", "1e-3"], ["0", "100"], ["5.", "+7"]]
)
def test_numbers_stay_numbers(cells, tmp_path, monkeypatch):
    """As programs and people write them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "values.csv").write_text(f"robot,a\n0,{cells[0]}\n1,{cells[1]}\n")

    [coloring] = read_colorings("values.csv:a", np.arange(2))

    assert not coloring.words
    assert coloring.value.tolist() == [float(cell) for cell in cells]


def test_texts_of_a_series_are_labels():
    """Its type says so, where a table has none."""
    texts = pd.Series(["1.10", "1.20"], index=[0, 1], name="version")

    [version] = read_colorings(texts, np.arange(2))

    assert version.words == ["1.10", "1.20"]


@pytest.mark.parametrize(
    ("header", "column", "problem"),
    [
        ("robot,a,a", "a", "values.csv:1: a: 2 columns are called a; rename all but one"),
        ("robot,a [V],a [A]", "a", "values.csv:1: a: 2 columns are called a; rename all but one"),
    ],
)
def test_columns_with_equal_names_are_refused(header, column, problem, tmp_path, monkeypatch):
    """The first would color robots, though the second may be meant."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "values.csv").write_text(f"{header}\n0,1,2\n1,3,4\n")

    with pytest.raises(InputError, match=f"^{problem}"):
        read_colorings(f"values.csv:{column}", np.arange(2))
    if header != "robot,a,a":
        [by_unit] = read_colorings("values.csv:a [A]", np.arange(2))
        assert by_unit.value.tolist() == [2.0, 4.0]


@pytest.mark.parametrize(
    ("lines", "column", "message"),
    [
        (["robot,a", "0,1"], "b", "values.csv:1: b: there is no such column; choose one of a"),
        (["place,a", "0,1"], "a", "values.csv:1: no column has numbers of robots; call one robot"),
        (
            ["robot,a", "0,1", "12,2"], "a",
            "values.csv:3: robot: there is no robot 12; robots are 0 to 11",
        ),
        (["robot,a", "0,1", "0,2"], "a", "values.csv:3: robot: robot 0 has a row already"),
        (["robot,a", "0,1", "1,x"], "a", "values.csv:3: a: 'x' is not a finite number"),
        (["robot,a", "0,1", "x,1"], "a", "values.csv:3: robot: 'x' is not a whole number"),
        (["robot,a", "0,1", "1"], "a", "values.csv:3: has 1 cells; 2 are needed"),
        (["robot,a", "0,", "1,nan"], "a", "values.csv:2: no row is complete"),
        (["robot,a", *(f"{n},w{n}" for n in range(9))], "a", "values.csv:1: a: has 9 labels"),
    ],
)  # fmt: skip
def test_wrong_tables_are_refused_by_file_and_line(
    tiswarm, small_run, tmp_path, lines, column, message
):
    """The command ends with one line, and writes nothing."""
    (tmp_path / "values.csv").write_text("\n".join(lines) + "\n")
    case = small_run / "cases/0-baseline"

    done = tiswarm(
        "view", case / "sensing.jsonl", case / "estimate.csv", "--color", f"values.csv:{column}",
        cwd=tmp_path,
    )  # fmt: skip

    assert done.returncode == 2
    assert done.stderr.startswith(f"tiswarm: error: {message}")
    assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["values.csv"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("values.csv", "--color: 'values.csv' names no column; write it like values.csv:charge"),
        ("none.csv:a", "none.csv: there is no such file"),
        (
            "values.csv:b",
            "values.csv:1: b: there is no such column; choose one of charge [V], role",
        ),
    ],
)
def test_what_names_no_column_is_refused(tiswarm, small_run, table, tmp_path, given, message):
    """The option has a file and a column."""
    assert (tmp_path / table).exists()

    done = tiswarm("export", small_run, "--color", given, cwd=tmp_path)

    assert done.returncode == 2
    assert done.stderr.startswith(f"tiswarm: error: {message}")


@given(
    st.lists(st.none() | st.floats(-1e6, 1e6), min_size=1, max_size=9), st.sampled_from([*SCALES])
)
def test_colors_lie_between_those_of_the_scale(values, scale):
    """Oracle: the place of a value between the least and the greatest, color by color."""
    value = np.array([np.nan if v is None else v for v in values])
    known = [v for v in values if v is not None]
    least = min(known, default=0.0)
    coloring = Coloring("a", "", value, scale, least)
    colors = [rgb(color) for color in SCALES[scale]]

    for v, color in zip(values, paint(coloring), strict=True):
        if v is None:
            assert color.tolist() == rgb(UNKNOWN_GRAY).tolist()
            continue
        place = (v - least) / max(max(known) - least, 1e-9) * (len(colors) - 1)
        k = min(int(place), len(colors) - 2)
        wanted = colors[k] + (place - k) * (colors[k + 1] - colors[k])
        assert np.allclose(color, wanted, atol=1e-6)


def test_pictures_have_the_color_of_each_robot(estimate, table):
    """A label has one color; robots without one are gray, and the legend names all."""
    own = estimate.log.colorings([f"{table}:role", f"{table}:charge"])
    pictures = build_pictures(view_log(estimate.log, estimate, user_colorings=own))

    picture = pictures["color-role"]
    docks = picture.scene.color[-12 * 3 :].reshape(12, 3, 3)  # after hubs and arms
    wanted = [LABEL_COLORS[place] for place in (0, 0, 1, 2)] + [UNKNOWN_GRAY] * 8
    assert np.allclose(docks, np.array([rgb(color) for color in wanted])[:, None], atol=1e-6)
    words = ["role", "scout", "relay", "carrier", "unknown"]
    assert [text for _, text in picture.legend] == words
    legend = pictures["color-charge"].legend
    assert (legend.low, legend.high) == ("charge [V]  10", "12.2")
    assert legend.keys == ((UNKNOWN_GRAY, "unknown"),)


def test_a_run_is_colored_where_its_structure_is_the_same(small_run, table):
    """Conditions of the seed have the same robots; those of another seed do not."""
    run = colored(load_run(small_run), f"{table}:charge", "1-no-z")

    owned = {case.name for case in run.cases if read_case_view(case).user_colorings}
    assert owned == {case.name for case in run.cases if case.name.startswith("1-")}
    first = build_view(run).data["cases"][0]
    assert first["name"].endswith("seed 1")
    assert first["colors"][0]["label"] == "charge"


def test_tables_of_an_export_have_the_values(estimate, table, tmp_path):
    """Programs that read them color by what the user measured."""
    estimate.export(
        "csv", color=[f"{table}:charge", f"{table}:role"], out=tmp_path / "out", quiet=True
    )

    rows = pd.read_csv(tmp_path / "out/estimate.csv")
    assert rows["charge [V]"].tolist()[:3] == [11.5, 10.0, 12.25]
    assert rows["role"].fillna("").tolist()[:5] == ["scout", "scout", "relay", "carrier", ""]


def test_spreadsheets_compute_no_label_of_an_exported_table(estimate, tmp_path):
    """Labels and names of columns that begin like formulas get an apostrophe; numbers stay."""
    path = tmp_path / "values.csv"
    labels = ["=1+1", "+a", "-a", "@a", "-1.5", "a=1"]
    rows = [f"{robot},{label},{-robot}" for robot, label in enumerate(labels)]
    path.write_text("\n".join(["robot,=role,-level", *rows]))

    estimate.export(
        "csv", color=[f"{path}:=role", f"{path}:-level"], out=tmp_path / "out", quiet=True
    )

    table = pd.read_csv(tmp_path / "out/estimate.csv", dtype={"'=role": str})
    written = table["'=role"].fillna("").tolist()
    assert written[:6] == ["'=1+1", "'+a", "'-a", "'@a", "-1.5", "a=1"]
    assert table["'-level"].tolist()[:3] == [0.0, -1.0, -2.0]


def test_the_page_opens_on_the_values(estimate, table, tmp_path):
    """The browser reports no error; the select offers the values first, and a robot its label."""
    page = estimate.view(color=[f"{table}:role", f"{table}:charge"])

    found = probe(
        page.read_text(),
        """
        const options = [...document.getElementById("quantity").options].map(({ text }) => text);
        const { colors } = JSON.parse(document.getElementById("data").textContent).cases[0];
        Object.assign(found, { options, value: colors[0].value, words: colors[0].words });
        document.body.dataset.found = JSON.stringify(found);
        """,
        tmp_path,
    )

    assert found["troubles"] == []
    assert found["options"][:2] == ["role", "charge"]
    assert found["words"] == ["scout", "relay", "carrier"]
    assert found["value"] == [0, 0, 1, 2, *[None] * 8]
    assert json.dumps(found["value"][0]) == "0"
