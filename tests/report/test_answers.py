"""The last line of a run, and the first of its page: true of any table."""

import itertools
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiswarm.base.registry import BUILT_IN
from tiswarm.localization.settings import all_cues
from tiswarm.measurements import cues
from tiswarm.records.measures import FEWEST
from tiswarm.report.answers import (
    Results,
    answer,
    conclusion,
    headline,
    two_digits,
)
from tiswarm.report.run_data import measured_words

REPOSITORY = Path(__file__).parents[2]
NONE = pd.DataFrame()
CUES = ("contacts", "contacts, height", "contacts, height, walk_contacts, non_overlap")
HEADER = re.compile(r"(?:Mean )?RMSE of (\d+) structures?(?: at each of (\d+) points)?: ")
WON = re.compile(r"(\w+) is best,")
COUNTED = re.compile(r"(\w+) is best at (\d+) of (\d+) points")


@st.composite
def studies(draw):
    """Draw the RMSE of each structure under some conditions at some points, and what they use."""
    shape = (draw(st.integers(1, 3)), draw(st.integers(1, 5)), draw(st.integers(1, 7)))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    is_clear = draw(st.booleans())
    level = random.permuted(np.tile(np.arange(shape[1]), (shape[0], 1)), axis=1)[..., None]
    rmse = 10.0 ** random.uniform(-2.0, 2.0, shape) if not is_clear else np.ones(shape)
    rmse = rmse + level * random.uniform(1.0, 2.0, shape) if is_clear else rmse
    used = [draw(st.sampled_from(CUES)) for _ in range(shape[1])]
    return rmse, used


def tables(rmse, used):
    """Tabulate a study as `table.csv` and `paired.csv` do."""
    points, conditions, structures = rmse.shape
    names = [f"c{n}" for n in range(conditions)]
    rows = [
        {
            "condition": name, "tilt": str(point), "cases": structures,
            "rmse_R_mean": rmse[point, n].mean(), "measurements": used[n],
        }
        for point in range(points)
        for n, name in enumerate(names)
    ]  # fmt: skip
    pairs = [
        {
            "condition": names[b], "against": names[a], "tilt": str(point), "measure": "rmse_R",
            "structures": structures, "smaller": int((rmse[point, b] < rmse[point, a]).sum()),
            "larger": int((rmse[point, b] > rmse[point, a]).sum()),
            "equal_measurements": used[a] == used[b],
        }
        for point in range(points)
        for a, b in itertools.combinations(range(conditions), 2)
    ]  # fmt: skip
    return pd.DataFrame(rows), pd.DataFrame(pairs)


def wins(rmse, used):
    """Count the points at which a condition errs least on each structure, by condition."""
    points, conditions, structures = rmse.shape
    found = {}
    for n in range(conditions) if structures >= FEWEST else ():
        others = [m for m in range(conditions) if m != n and used[m] == used[n]]
        won = [(rmse[p, n] < rmse[p, others]).all() for p in range(points)]
        found |= {f"c{n}": sum(won)} if others and any(won) else {}
    return found


@settings(max_examples=25)
@given(study=studies())
def test_a_sentence_contains_the_least_error_of_all(study):
    """No sentence is about losers alone."""
    rmse, used = study
    table, pairs = tables(rmse, used)

    texts = [answer(question, Results(table, pairs, NONE)) for question in BUILT_IN["question"]]

    least = two_digits(rmse.mean(axis=2).min())
    assert all(re.search(rf"\b{re.escape(least)} (?:R|to)", text) for text in texts)


@settings(max_examples=25)
@given(study=studies())
def test_the_smallest_error_is_so_on_each_of_enough_structures(study):
    """Points are points of the sweep, and fewer than five structures have numbers alone."""
    rmse, used = study

    text = conclusion(*tables(rmse, used))

    structures, points = HEADER.match(text).groups()
    assert (int(structures), int(points or 1)) == (rmse.shape[2], rmse.shape[0])
    if rmse.shape[0] == 1:
        assert dict.fromkeys(WON.findall(text), 1) == wins(rmse, used)
    else:
        stated = {name: (int(won), int(of)) for name, won, of in COUNTED.findall(text)}
        assert stated == {name: (won, rmse.shape[0]) for name, won in wins(rmse, used).items()}


def compared(*errors, structures=FEWEST, equal=True):
    """Tabulate conditions a, b, ... whose order is that of their mean errors on each structure."""
    names = "abcdefg"[: len(errors)]
    table = pd.DataFrame({"condition": [*names], "cases": structures, "rmse_R_mean": errors})
    pairs = [
        {
            "condition": names[j], "against": names[i], "measure": "rmse_R",
            "structures": structures, "smaller": structures * (errors[j] < errors[i]),
            "larger": structures * (errors[j] > errors[i]), "equal_measurements": equal,
        }
        for i, j in itertools.combinations(range(len(errors)), 2)
    ]  # fmt: skip
    return table.assign(measurements=CUES[1]), pd.DataFrame(pairs)


def test_conditions_with_equal_measurements_are_named_by_these():
    """A reader sees what each group knows, in words: another one, or what the first one lacks."""
    table, pairs = compared(0.52, 2.56, 1.3, 0.13)
    table.loc[3, "measurements"] = CUES[2]
    pairs["equal_measurements"] = ~(pairs["condition"] == "d")

    text = conclusion(table, pairs)

    assert text == (
        "Mean RMSE of 5 structures: with contacts, heights, contacts on the way and non-overlap, "
        "d 0.13 R. With contacts and heights, a is best, 0.52 R; c 1.3 R, b 2.6 R"
    )


@pytest.mark.parametrize("structures", [1, 3, FEWEST - 1])
def test_few_structures_have_numbers_alone(structures):
    """Three differences of one sign are chance in a quarter of all studies."""
    text = conclusion(*compared(0.5, 1.3, structures=structures))

    assert "best" not in text
    assert text.endswith(": a 0.50 R; b 1.3 R (same measurements)")


def test_many_conditions_with_measurements_of_their_own_are_one_list():
    """The names of their measurements would fill a page; the table has them."""
    table, pairs = compared(0.5, 1.3, 0.2, 7.0, 2.0, equal=False)

    text = conclusion(table, pairs)

    assert text == (
        "Mean RMSE of 5 structures: 5 conditions, each with other measurements or noise, "
        "c 0.20 R, a 0.50 R, b 1.3 R, and 2 more up to 7.0 R"
    )


TOWER_CUES = "contacts, height, ground, non_overlap"


def test_a_readme_states_what_a_run_of_it_prints():
    """Numbers differ by kind of processor; words, and who stands beside whom, do not."""
    table, pairs = compared(3.7, 1.9, 0.66, 0.24, structures=3)
    names = ["Algorithm 1", "Algorithm 1 (all at once)", "joint", "joint (with walks)"]
    labels = dict(zip("abcd", names, strict=True))
    pairs["equal_measurements"] = ~(pairs["condition"] == "d")
    pairs = pairs.replace({"condition": labels, "against": labels})
    table = table.assign(condition=names, measurements=TOWER_CUES)
    table.loc[3, "measurements"] += ", walk_contacts"

    said = f"{answer('least-error', Results(table, pairs, NONE))}."

    readme = (REPOSITORY / "README.md").read_text().splitlines()
    [stated] = [line for line in readme if line.startswith("Mean RMSE of 3 structures")]
    assert re.sub(r"\d+\.\d+", "#", stated) == re.sub(r"\d+\.\d+", "#", said)
    assert len(said) <= 230  # letters of two lines on a page


@pytest.mark.parametrize("count", [2, 3, 4])
def test_each_of_a_few_conditions_is_named_with_its_error(count):
    """A method that a run was made to compare does not end among "1 more"."""
    errors = [3.7, 1.9, 0.66, 0.24][:count]
    for equal in (True, False):
        table, pairs = compared(*errors, structures=3, equal=equal)
        for long in ("", " with a name that is too long to fit twice"):
            named = table.assign(condition=[f"{name}{long}" for name in "abcd"[:count]])

            text = answer("least-error", Results(named, pairs, NONE))

            assert all(f"{name} {two_digits(error)} R" in text
                       for name, error in zip(named["condition"], errors, strict=True))  # fmt: skip
            assert "more" not in text


def test_swept_methods_are_compared_under_each_condition():
    """Conditions are levels of noise there, and no noise would always win."""
    table = pd.DataFrame({"condition": ["none", "much"] * 2, "cases": FEWEST})
    table.insert(1, "localization.method", [*"aabb"])
    rmse = np.array([1.0, 9.0, 2.0, 10.0])
    table = table.assign(rmse_R_mean=rmse, rmse_R_least=rmse - 0.1, rmse_R_most=rmse + 0.1)

    text = conclusion(table.assign(measurements="contacts"), NONE)
    others = conclusion(table.assign(measurements=["contacts"] * 2 + ["ranges"] * 2), NONE)

    assert text == (
        "Mean RMSE of 5 structures under each of 2 conditions: "
        "a is best at 2 of 2 points, 1.0 to 9.0 R; b 2.0 to 10 R (same measurements)"
    )
    assert "best" not in others


@pytest.mark.parametrize("question", BUILT_IN["question"])
def test_without_the_part_there_are_errors_alone(monkeypatch, question):
    """A copy that cannot answer a question has the sentence on errors, which is in the core."""
    results = Results(*compared(0.5, 1.3, structures=2), NONE)
    monkeypatch.setitem(sys.modules, "tiswarm.report.questions", None)

    assert answer(question, results) == conclusion(results.table, results.pairs)


def test_each_cue_has_words():
    """Nobody has to know the keys of settings to read a page."""
    assert {cue.name for cue in cues.CUES if cue.words} == {*all_cues()}
    assert measured_words("my_cue, contacts") == "contacts and my cue"
    assert measured_words("") == ""


def test_what_structures_reached_is_counted_by_row():
    """Bridges are closed or not; where robots know the truth, all conditions share structures."""
    table = pd.DataFrame({"condition": ["online", "first"] * 3})
    table["structure"] = ["tower"] * 2 + ["bridge gap 20 R"] * 4
    table["structure.navigate_by"] = ["by truth"] * 4 + ["by estimate"] * 2
    table = table.assign(
        cases=4, rmse_R_mean=1.0, kind=["tower"] * 2 + ["bridge"] * 4,
        height_R_mean=[31.7, 31.7, 9.0, 9.0, 9.0, 9.0], crossed_mean=[0, 0, 0.75, 0.75, 1.0, 0.25],
    )  # fmt: skip

    text = answer("reached", Results(table, NONE, NONE))

    assert text == (
        "Means of 4 structures: tower, by truth: height 32 R; "
        "bridge gap 20 R, by truth: bridges closed 3 of 4; "
        "bridge gap 20 R, by estimate: bridges closed 4 of 4 (online), 1 of 4 (first); "
        "RMSE online 1.0 R, first 1.0 R"
    )


def test_what_structures_reached_at_many_points_is_a_range_of_each_kind():
    """Thirty rows would be no sentence."""
    table = pd.DataFrame({"condition": "a", "force": [*map(str, range(12))], "cases": 2})
    table = table.assign(kind=["chain"] * 6 + ["bridge"] * 6, rmse_R_mean=1.0)
    table = table.assign(depth_R_mean=np.arange(12) + 4.0, crossed_mean=0.5)

    text = answer("reached", Results(table, NONE, NONE))

    head = "Means of 2 structures: depth of chains 4.0 to 9.0 R, bridges closed 50 %"
    assert text == f"{head}; RMSE 1.0 R"


def test_rmse_at_a_budget_names_what_robots_send():
    """Methods that have all logs in one place are no rivals of those that send bytes."""
    table, pairs = compared(0.2, 0.35, 0.3, 3.0, structures=2)
    sent = [np.nan, 700.0, 4000.0, 90.0]

    text = answer("traffic", Results(table.assign(sent_B_mean=sent), pairs, NONE))

    assert text == (
        "Mean RMSE of 2 structures: of those whose robots send at most 1 kB each, "
        "b 0.35 R at 0.70 kB, d 3.0 R at 0.090 kB; of those that send more, c 0.30 R at 4.0 kB; "
        "with the log of all robots in one place, a 0.20 R"
    )


@pytest.mark.parametrize(
    ("structures", "end"), [(4, ""), (5, "; in the paper's order at 1 of 2 points")]
)
def test_the_order_of_the_cues_is_beside_that_of_the_paper(structures, end):
    """Rows without a published number have no place in its order."""
    table = pd.DataFrame({"condition": ["all", "no-z", "own"] * 2, "kind": [*"aaabbb"]})
    table = table.assign(cases=structures, rmse_R_mean=[2.0, 3.0, 9.0, 4.0, 3.0, 8.0])
    table["paper_rmse_radii"] = [1.6, 1.8, None, 3.9, 5.3, None]

    text = answer("cues", Results(table, NONE, NONE))

    assert text == (
        f"Mean RMSE of {structures} structures at each of 2 points: all 2.0 to 4.0 R, "
        f"no-z 3.0 R (-25 to +50 %), own 8.0 to 9.0 R (+100 to +350 %){end}"
    )


def test_exponents_are_those_of_the_table():
    """A power is what a study of scaling asks about."""
    robots = [100, 1000] * 2
    scaling = pd.DataFrame({"series": ["a"] * 4 + ["b"] * 4, "robots": robots * 2})
    scaling["measure"] = ["rmse_R", "rmse_R", "localize_cpu_s", "localize_cpu_s"] * 2
    scaling = scaling.assign(
        mean=[2.0, 4.0, 1.0, 10.0, 0.6, 0.5, 2.0, 30.0],
        exponent=[0.3, 0.3, 1, 1, -0.08, -0.08, 1.2, 1.2],
    )
    table, pairs = compared(0.5, 2.0, structures=3)

    text = answer("scaling", Results(table, pairs, scaling))
    without = answer("scaling", Results(table, pairs, scaling.assign(exponent=np.nan)))

    assert text == (
        "From 100 to 1,000 robots, 3 structures each, RMSE of b 0.60 to 0.50 R as N^-0.08, "
        "a 2.0 to 4.0 R as N^0.30; CPU time of localization of b as N^1.20, a as N^1.00"
    )
    assert without.startswith("Mean RMSE of 3 structures: ")  # two sizes have no exponent


@pytest.mark.parametrize("question", [*BUILT_IN["question"], "nonsense", "None"])
def test_a_question_without_its_results_has_the_answer_on_errors(question):
    """A run that was made smaller than its study, or by an older version, has a sentence too."""
    table, pairs = compared(0.5, 1.3, structures=2)

    text = answer(question, Results(table, pairs, NONE))

    assert text.startswith("Mean RMSE of 2 structures: ")
    assert re.search("a 0.50 R[;,] b (2.6x|1.3 R)", text)


def test_the_question_of_a_run_is_that_of_its_scenario(tmp_path):
    """It has the labels of conditions, or their names."""
    measures = dict.fromkeys(["rmse_R_ci95", "rmse_R_least", "rmse_R_most"], 1.0)
    table, pairs = compared(0.5, 1.3, structures=2)
    table = table.assign(procrustes_disparity_mean=0.1, **measures)
    pairs = pairs.assign(difference_mean=0.8, wilcoxon_p=0.5)
    table = table.assign(kind="tower", height_R_mean=[12.0, 13.0])
    table.to_csv(tmp_path / "table.csv", index=False)
    pairs.to_csv(tmp_path / "paired.csv", index=False)
    (tmp_path / "scenario.yaml").write_text("question: reached\n")

    last = headline(tmp_path).splitlines()[-1]
    (tmp_path / "scenario.yaml").write_text(
        "question: reached\nconditions: {a: {label: A}, b: {}}\n"
    )
    shown = headline(tmp_path).splitlines()[-1]

    assert last == "Means of 2 structures: height 12 R (a), 13 R (b); RMSE a 0.50 R, b 1.3 R."
    assert shown == "Means of 2 structures: height 12 R (A), 13 R (b); RMSE A 0.50 R, b 1.3 R."


def test_methods_under_one_condition_have_no_common_traffic():
    """The error of one method would stand beside the bytes of another, in the order of rows."""
    table = pd.DataFrame({"condition": "all", "localization.method": ["distributed", "joint"]})
    table = table.assign(cases=2, rmse_R_mean=[0.2, 0.1], sent_B_mean=[5000.0, np.nan])
    table = table.assign(measurements="contacts")

    texts = [answer("traffic", Results(t, NONE, NONE)) for t in (table, table[::-1])]

    assert all("joint 0.10 R; distributed 0.20 R" in text for text in texts)


@pytest.mark.parametrize("points", [1, 12])
def test_bridges_without_a_count_are_not_counted(points):
    """A table that somebody has edited ends no report in a traceback."""
    table = pd.DataFrame({"condition": "a", "force": [*map(str, range(points))], "cases": 2})
    table = table.assign(kind="bridge", rmse_R_mean=1.0, crossed_mean=np.nan)

    text = answer("reached", Results(table, NONE, NONE))

    assert text.startswith("Mean RMSE of 2 structures")


@pytest.mark.parametrize(("joined", "of_all"), [({"joined_mean": 9.0}, " of 9"), ({}, "")])
def test_disconnected_robots_are_counted_among_those_that_are_known(tmp_path, joined, of_all):
    """A table that lost a column ends no report in a traceback."""
    measures = dict.fromkeys(["rmse_R_ci95", "rmse_R_least", "rmse_R_most"], 1.0)
    table = pd.DataFrame({"condition": ["a"], "cases": 2, "rmse_R_mean": 1.0, **measures})
    table = table.assign(procrustes_disparity_mean=0.1, disconnected_mean=2.0, **joined)
    table.to_csv(tmp_path / "table.csv", index=False)

    assert headline(tmp_path).endswith(f", 2{of_all} robots disconnected on average")
