"""The scorecard separates structures that follow the published laws from those that do not."""

import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image

from benchmarks.reactivebuild import laws
from benchmarks.reactivebuild.__main__ import compare
from benchmarks.reactivebuild.curves import Curve, Form, fit
from benchmarks.reactivebuild.figures import (
    CAPTIONS,
    FIGURES,
    draw_cross_section,
    draw_figures,
    draw_towers,
)
from benchmarks.reactivebuild.laws import (
    LAWS,
    Band,
    Row,
    above,
    at_least,
    at_most,
    below,
    law_points,
    within,
)
from benchmarks.reactivebuild.structures import SETTINGS, TOTALS, Structures
from tests.benchmarks.commands import call
from tests.report.conftest import is_blank
from tests.runs import REPOSITORY

SEEDS = (0, 1, 2)
THRESHOLDS = (1.0, 2.5, 5.0, 10.0, 25.0)
GAINED = {1.0: 0.0, 2.5: 0.4, 5.0: 1.0, 10.0: 5.0, 25.0: 9.0}
RATIO = "greatest ratio of height at one J to the J before"
ACROSS = "share across a gap of"
GAIN = "reach gained from N = 25 to 100 [R]"
STANDARD = {"force_threshold": 10.0, "recruit_base": 3.0, "recruit_limit": 5, "gap": np.nan}


def structure(kind, name, **known):
    """One structure, its settings and totals: those that matter are given."""
    nothing = dict.fromkeys(TOTALS, 0.0) | {"robots": 100, "rms_radius_R": 9.75}
    settings = {"kind": kind, **STANDARD}
    return {"case": f"{kind}-{name}", **settings, **nothing, **known}


def towers():
    """Towers of exact height and peak over F, B and J, and of none called."""
    for f in THRESHOLDS:
        yield {"force_threshold": f, "height_R": tower_height(f), "peak_stress": 10 + 19 * f}
    for f in (2.5, 5.0):
        base = {"force_threshold": f, "height_R": tower_height(f), "peak_stress": 10 + 19 * f}
        for b in (1.5, 6.0, 10.0):
            scaled = {k: base[k] * (0.5 + 1.5 / b) for k in ("height_R", "peak_stress")}
            yield base | scaled | {"recruit_base": b}
        for j, factor in ((1, 1.5), (2, 1.2), (1000, 0.9)):
            scaled = {k: base[k] * factor for k in ("height_R", "peak_stress")}
            yield base | scaled | {"recruit_limit": j}
    yield {"recruit_limit": 0, "height_R": 65.0, "peak_stress": 4000.0}


def tower_height(threshold):
    """Affine in sqrt F, 37.5 R at F = 10."""
    return 12.5 * np.sqrt(threshold) - 2.0


def edges():
    """Cantilevers, bridges and chains."""
    for f in THRESHOLDS:
        yield "cantilever", {"force_threshold": f}
    for f in (2.5, 10.0):
        for gap in (20.0, 25.0, 30.0):
            crossing = {"crossed": 1.0, "robots": 40} if f > 5.0 else {}
            yield "bridge", dict(force_threshold=f, gap=gap, **crossing)
    for f in THRESHOLDS[1:]:
        yield "chain", {"force_threshold": f, "depth_R": 10.0 * f**0.75}


def joins(row):
    """Growth of one structure after laws of N."""
    n = np.arange(1.0, 101.0)
    return pd.DataFrame(
        {
            "case": row["case"],
            "robots": n,
            "height_R": row["height_R"] * (0.5 + 0.05 * np.sqrt(n)),
            "reach_R": 6.0 + GAINED.get(row["force_threshold"], 0.0) * (n - 25.0) / 75.0,
            "depth_R": 3.0 + 2.0 * np.log(n),
            "peak_stress": 5.0 + 2.0 * n,
        }
    )


def spheres(row):
    """So many spheres in layers 1 R apart that a cross-section is 3 d^2 + 2 of them."""
    depth = np.arange(int(row["height_R"]))
    return pd.DataFrame(
        {"case": row["case"], "z_R": np.repeat(1.0 + depth[::-1], np.maximum(1, depth**2))}
    )


@pytest.fixture(scope="module")
def exact():
    """Structures that follow every law, the seeds differing a little but not in the mean."""
    kinds = [("tower", known) for known in towers()] + list(edges())
    rows = [
        structure(kind, f"{place}-{seed}", **known)
        | {"peak_stress": known.get("peak_stress", 0.0) + seed - 1.0}
        for place, (kind, known) in enumerate(kinds)
        for seed in SEEDS
    ]
    return Structures(
        totals=pd.DataFrame(rows, columns=["case", *SETTINGS, *TOTALS]),
        joins=pd.concat(map(joins, rows)),
        spheres=pd.concat([spheres(row) for row in rows if 20.0 < row["height_R"] < 40.0]),
    )


def changed(structures, kind, column, value, **where):
    """Set one total of some structures to a value."""
    table = structures.totals.astype({column: float})
    chosen = table["kind"] == kind
    for name, setting in where.items():
        chosen &= table[name] == setting
    table.loc[chosen, column] = value
    return replace(structures, totals=table)


def scorecard(structures):
    """Measure every number; return the table of numbers and the points behind them."""
    rows = laws.measure(structures)
    return laws.scorecard(rows), law_points(laws.curves_of(rows))


def verdicts(structures):
    """Return the verdicts by law and quantity."""
    return scorecard(structures)[0].set_index(["law", "quantity"])["verdict"]


@pytest.fixture(scope="module")
def good(exact):
    """Verdicts where every law holds."""
    return verdicts(exact)


def test_where_every_law_holds_every_row_is_in_band(exact):
    """Each law has rows, and every row with a band is in it."""
    rows, points = scorecard(exact)

    judged = rows[rows["band"] != ""]
    assert set(judged["verdict"]) == {"in band"}
    assert set(rows[rows["band"] == ""]["verdict"]) == {"reported"}
    assert set(rows["law"]) == {law.name for law in LAWS}
    assert (rows["structures"] >= len(SEEDS)).all()
    assert points.notna()[["law", "series", "x", "mean"]].all(axis=None)


def test_what_follows_a_law_exactly_is_fitted_exactly(exact):
    """R2 is 1; formula and exponents are those of the data."""
    rows, _ = scorecard(exact)
    rows = rows.set_index(["law", "quantity"])

    for law, quantity, formula in (
        ("tower height over F", "R2 of a + b F^0.5", "-2 + 12.5 F^0.5"),
        ("tower peak over F", "R2 of a + b F", "10 + 19 F"),
        ("tower peak over N", "R2 of a + b N, F = 10", "5 + 2 N"),
        ("chain depth over N", "R2 of a + b ln N, F = 10", "3 + 2 ln N"),
    ):
        assert rows.loc[(law, quantity), "ours"] == pytest.approx(1.0)
        assert rows.loc[(law, quantity), "fit"] == formula
    assert rows.loc[("chain depth over F", "exponent"), "ours"] == pytest.approx(0.75)
    assert rows.loc[("cantilever reach", f"{GAIN}, F = 25"), "ours"] == pytest.approx(9.0)


F, B, J = "force_threshold", "recruit_base", "recruit_limit"
BREACHES = [
    ("tower height over F", "exponent, F >= 2.5", "tower", "height_R", 20.0, {}),
    ("tower height over F", "R2 of a + b F^0.5", "tower", "height_R", 5.0, {F: 25.0}),
    ("tower peak over F", "R2 of a + b F", "tower", "peak_stress", 9.0, {F: 25.0}),
    ("tower peak over F", "exponent", "tower", "peak_stress", 1.0, {F: 1.0}),
    ("tower height over B", "R2 of a + b / B, F = 5", "tower", "height_R", 50.0, {B: 10.0}),
    ("tower peak over B", "R2 of a + b / B, F = 2.5", "tower", "peak_stress", 99.0, {B: 10.0}),
    ("tower height over J", f"{RATIO}, F = 2.5", "tower", "height_R", 40.0, {J: 1000}),
    ("tower peak over J", "peak at J = 1 / at J = 5, F = 5", "tower", "peak_stress", 9.0, {J: 1}),
    ("tower without recruitment", "height at J = 0 [R]", "tower", "height_R", 59.0, {J: 0}),
    ("tower without recruitment", "peak at J = 0 / at J = 5", "tower", "peak_stress", 9.0, {J: 0}),
    ("tower shape", "height [R]", "tower", "height_R", 32.0, {F: 10.0, J: 5}),
    ("tower shape", "rms radius [R]", "tower", "rms_radius_R", 18.0, {}),
    ("cantilever shape", "rms radius [R]", "cantilever", "rms_radius_R", 18.0, {}),
    ("bridge success", f"{ACROSS} 20 R, F = 10", "bridge", "crossed", 0.0, {"gap": 20.0}),
    ("bridge success", f"{ACROSS} 30 R, F = 10", "bridge", "robots", 100.0, {"gap": 30.0}),
]


@pytest.mark.parametrize(("law", "quantity", "kind", "column", "value", "where"), BREACHES)
def test_a_total_that_breaks_a_law_is_out_of_band(
    exact, good, law, quantity, kind, column, value, where
):
    """The row of the law is out of band; rows of other laws are not."""
    broken = changed(exact, kind, column, value, **where)

    said = verdicts(broken)
    assert good[law, quantity] == "in band"
    assert said[law, quantity] == "out of band"
    assert said["tower cross-section", "R2 of k d^2, F = 5"] == "in band"


@pytest.mark.parametrize(
    ("law", "quantity", "column", "value"),
    [
        ("tower height over N", "R2 of a + b N^0.5, F = 10", "height_R", lambda n: (n - 60.0) ** 2),
        ("tower height over N", "height at N = 100 / at N = 25, F = 10", "height_R", np.square),
        ("cantilever reach", f"{GAIN}, F = 5", "reach_R", lambda n: 0.1 * n),
        ("cantilever reach", f"{GAIN}, F = 10", "reach_R", lambda n: 9.0 + 0.0 * n),
    ],
)
def test_growth_that_breaks_a_law_is_out_of_band(exact, good, law, quantity, column, value):
    """Laws of N use every join, not only the last."""
    broken = replace(exact, joins=exact.joins.assign(**{column: value(exact.joins["robots"])}))

    assert good[law, quantity] == "in band"
    assert verdicts(broken)[law, quantity] == "out of band"


def test_a_tower_as_thick_at_the_top_as_below_breaks_the_cross_section_law(exact):
    """A column of one thickness does not fit k d^2, and its R2 may be below zero."""
    column = [pd.DataFrame({"case": c, "z_R": np.arange(40.0)}) for c in exact.totals["case"]]
    broken = replace(exact, spheres=pd.concat(column))

    assert verdicts(broken)["tower cross-section", "R2 of k d^2, F = 10"] == "out of band"


def test_without_structures_every_row_is_there_and_not_measured(exact):
    """A run of other structures has all rows, so it cannot pass by omission."""
    nothing = Structures(totals=exact.totals[:0], joins=exact.joins[:0], spheres=exact.spheres[:0])

    rows, points = scorecard(nothing)

    whole, _ = scorecard(exact)
    assert set(rows["verdict"]) == {"not measured"}
    pd.testing.assert_frame_equal(rows[["law", "quantity"]], whole[["law", "quantity"]])
    assert points.empty


def test_cross_sections_count_spheres_within_one_radius():
    """Counts agree with those by hand, for one tower and for two."""
    low = pd.DataFrame({"case": "low", "z_R": [1.0, 3.5, 4.0, 5.0]})
    tall = pd.DataFrame({"case": "tall", "z_R": [1.0, 9.0]})
    table = pd.DataFrame({"case": ["low", "tall"]})

    alone = Structures(totals=table[:1], joins=low, spheres=low)
    both = replace(alone, totals=table, spheres=pd.concat([low, tall]))
    alone, both = alone.means("distance", ""), both.means("distance", "")

    assert alone["x"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert alone["mean"].tolist() == [2.0, 3.0, 2.0, 1.0, 1.0]
    assert both["mean"].tolist() == [1.5, 2.0, 1.0, 0.5, 0.5]
    assert both["structures"].tolist() == [2] * 5


def test_only_complete_structures_are_behind_a_law_of_robots(exact):
    """A structure that ended early would make the mean jump."""
    table = exact.totals[exact.totals["kind"] == "chain"].copy()
    short = table["case"].iloc[0]
    table.loc[table["case"] == short, "robots"] = 60
    chains = replace(exact, totals=table).of("chain", **{F: 2.5})

    points = chains.means("robots", "depth_R")

    assert points["x"].tolist() == list(range(1, 101))
    assert set(points["structures"]) == {len(SEEDS) - 1}


def test_fits_recover_exact_coefficients():
    """The formula has the coefficients of the data; R2 is NaN with too few points."""
    x = np.array([1.0, 4.0, 9.0, 16.0])
    root = Form("x^0.5", np.sqrt)
    no_constant = root._replace(has_constant=False)

    assert fit(x, 3.0 + 2.0 * np.sqrt(x), root).formula == "3 + 2 x^0.5"
    assert fit(x, 5.0 * np.sqrt(x), no_constant).formula == "5 x^0.5"
    assert fit(x, 9.0 - np.sqrt(x), no_constant).r2 < 0.0
    assert np.isnan(fit(x[:2], x[:2], root).r2)


@pytest.mark.parametrize(
    ("band", "inside", "outside"),
    [
        (within(1.0, 2.0), (1.0, 1.5, 2.0), (0.99, 2.01)),
        (at_least(0.9), (0.9, 1.0), (0.89,)),
        (at_most(0.1), (0.0, 0.1), (0.11,)),
        (above(2.5), (2.51,), (2.5, 0.0)),
        (below(1.0), (0.99, -3.0), (1.0, 2.0)),
    ],
)
def test_bands_know_their_ends(band: Band, inside, outside):
    """Only closed bands include their ends; NaN is neither in nor out."""

    def verdict(value):
        return Row("law", "quantity", "", value, band, structures=1).verdict

    assert {verdict(value) for value in inside} == {"in band"}
    assert {verdict(value) for value in outside} == {"out of band"}
    assert verdict(float("nan")) == "not measured"


@pytest.mark.parametrize(
    "empty", [False, pytest.param(True, marks=pytest.mark.trial)], ids=["every law", "no structure"]
)
def test_every_figure_is_drawn(exact, empty, tmp_path):
    """Each figure shows something, axes at least."""
    structures = replace(exact, totals=exact.totals[:0]) if empty else exact

    written = draw_figures(laws.curves_of(laws.measure(structures)), tmp_path)

    assert {path.stem for path in written} == set(FIGURES)
    for path in written:
        with Image.open(path) as image:
            assert not is_blank(image)


def test_figures_show_the_means_and_the_published_form(exact):
    """Dots are the means; the dashed line is the fit; the legend gives its R2."""
    curves = laws.curves_of(laws.measure(exact))
    curve = curves["tower height over F"][""]

    over_f = draw_towers(curves).axes[0]
    section = draw_cross_section(curves).axes[0]

    dots, dashed = over_f.lines[0], over_f.lines[-1]
    np.testing.assert_allclose(dots.get_xydata(), curve.points[["x", "mean"]])
    np.testing.assert_allclose(dashed.get_ydata(), curve.points["fitted"])
    assert dashed.get_linestyle() == "--"
    assert over_f.get_legend_handles_labels()[1] == [f"R² = {curve.r2:.3f}"]
    assert section.get_xscale() == section.get_yscale() == "log"
    assert section.lines[0].get_xdata().min() == 1.0


def test_a_curve_with_one_structure_has_no_error_bar():
    """The standard deviation of one structure is NaN, which a figure shows as 0."""
    points = pd.DataFrame({"x": [20.0], "mean": [0.5], "std": [np.nan], "structures": [1]})
    curve = Curve.through(points)

    axes = draw_towers({"tower height over J": {"F = 5": curve}}).axes[2]

    bar = axes.collections[0].get_segments()[0]
    assert np.isfinite(bar).all()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Call the command with two seeds of eight robots under two conditions."""
    out = tmp_path_factory.mktemp("laws")
    scenario = yaml.safe_load((REPOSITORY / "scenarios" / "reactivebuild-laws.yaml").read_text())
    scenario |= {"robots": 20, "seeds": 2}
    scenario |= {"conditions": {"a": {}, "b": {"localization.iterations": 2}}}
    (out / "laws.yaml").write_text(yaml.safe_dump(scenario))
    done = call("reactivebuild", out / "laws.yaml", "--set", "robots=8", "--out", out)
    assert done.returncode == 0, done.stderr
    return next(out.glob("reactivebuild-laws-*")), done.stdout


@pytest.mark.trial
def test_a_small_run_writes_every_row(finished):
    """Numbers that need 25 robots or more are there but not measured."""
    folder, _ = finished
    table = pd.read_csv(folder / "reactivebuild" / "laws.csv", keep_default_na=False)

    large = table["quantity"].str.contains("N = 100")
    plain = table["law"].isin({"tower shape", "tower height over J", "bridge success"})
    assert table["law"].drop_duplicates().tolist() == [*dict.fromkeys(law.name for law in LAWS)]
    assert set(table[large]["verdict"]) == {"not measured"}
    assert set(table[plain]["verdict"]) == {"in band", "out of band", "reported"}


@pytest.mark.trial
def test_a_structure_counts_once_whatever_the_conditions(finished):
    """Two seeds under two conditions are two structures."""
    folder, _ = finished
    table = pd.read_csv(folder / "reactivebuild" / "laws.csv").set_index(["law", "quantity"])

    assert table.loc[("tower shape", "height [R]"), "structures"] == 2


@pytest.mark.trial
def test_the_last_line_counts_the_numbers_in_band(finished):
    """Numbers that are not measured are not judged."""
    folder, printed = finished
    verdict = pd.read_csv(folder / "reactivebuild" / "laws.csv")["verdict"].value_counts()

    judged = verdict["in band"] + verdict["out of band"]
    assert printed.splitlines()[-1] == (
        f"laws.csv: {verdict['in band']} of {judged} in band, {verdict['reported']} reported, "
        f"{verdict['not measured']} not measured"
    )


@pytest.mark.trial
def test_a_run_folder_gives_the_same_files_again(finished):
    """The scorecard follows from the stored cases alone."""
    folder, printed = finished
    place = folder / "reactivebuild"
    before = {path.name: path.read_bytes() for path in place.iterdir()}
    shutil.rmtree(place)

    done = call("reactivebuild", folder)

    assert done.returncode == 0, done.stderr
    assert {path.name: path.read_bytes() for path in place.iterdir()} == before
    assert set(before) == {"laws.csv", "law-points.csv", "laws.html"} | {
        f"{n}.png" for n in FIGURES
    }
    assert done.stdout.splitlines()[-1] == printed.splitlines()[-1]
    page = before["laws.html"].decode()
    assert all(caption in page for caption in CAPTIONS.values())


@pytest.mark.trial
def test_failed_cases_are_counted(finished, tmp_path):
    """Structures of failed cases are left out, and the summary says how many."""
    folder, _ = finished
    copy = shutil.copytree(folder, tmp_path / folder.name)
    summary = pd.read_csv(copy / "summary.csv")
    summary.loc[0, "status"] = "failed"
    summary.to_csv(copy / "summary.csv", index=False)

    assert compare(copy).endswith("; 1 case failed")


@pytest.mark.trial
def test_a_folder_without_a_run_is_refused(tmp_path):
    """The message names the folder and what to give instead."""
    done = call("reactivebuild", tmp_path)

    assert done.returncode == 2
    assert f"{tmp_path}: this is not a run folder" in done.stderr
