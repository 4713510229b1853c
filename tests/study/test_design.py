"""Designs predict errors as a dense solve does, and verify what nothing surpasses."""

from contextlib import suppress

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import tiswarm
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.base.robot import RobotGeometry
from tiswarm.measurements.advice.expected_error import expected_square
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import SPACING
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.design.candidates import Candidate, list_candidates
from tiswarm.study.design.goals import Goal, on_front, parse_goal, parse_goals, surpassed_by
from tiswarm.study.design.prices import Prices
from tiswarm.study.design.search import (
    FIRST_FRESH_SEED,
    FIRST_SEED,
    MOST_SEEDS,
    predict,
    search,
    without_errors,
)
from tiswarm.world.growth import batch_key, grow, grow_each
from tiswarm.world.params import ClimbParams, TowerParams

BASE = {
    "name": "task",
    "robots": 8,
    "structure": {"kind": "tower"},
    "sensing": {"tilt_noise_deg": 1.0},
    "localization": {"method": "hop-by-hop"},
}
"""A small scenario whose method takes milliseconds."""

TILTS = {"sensing.tilt_noise_deg": [1, 4], "sensing.stances": [True, False]}
PRICES = {"sensing.tilt_noise_deg": {1: 8, 4.0: 1}, "sensing.stances": {True: 2, False: 0}}

names = st.from_regex(r"[A-Za-z]\w{0,12}", fullmatch=True)
bounds = st.floats(-1e9, 1e9)
costs = st.lists(st.tuples(*[st.sampled_from([0.0, 1.0, 2.0, np.inf])] * 3), min_size=1, max_size=9)


@given(names, st.booleans(), bounds)
def test_a_goal_reads_back(name, larger, bound):
    """What a goal prints is the goal, with a bound or without, and spaces make no difference."""
    bounded = Goal(name=name, larger=larger, bound=float(f"{bound:.12g}"))
    unbounded = Goal(name=name, larger=larger)

    for goal in (bounded, unbounded):
        spaced = str(goal).replace("<", " < ").replace(">", " > ").replace(":", ": ")
        assert str(parse_goal(str(goal))) == str(goal) == str(parse_goal(f" {spaced} "))
    assert parse_goal(str(bounded)) == bounded


@given(st.text(max_size=20))
def test_a_text_is_a_goal_or_is_refused_in_a_line(text):
    """Nothing but a goal passes, and no text makes another exception."""
    goal = None
    with suppress(InputError):
        goal = parse_goal(text)

    assert goal is None or (goal.name in text and any(sign in text for sign in "<>:"))


@pytest.mark.parametrize("text", ["rmse_R", "rmse_R<=1", "a<1<2", "<1", "max:a<1", "a<nan", "a>x"])
def test_what_has_no_direction_or_number_is_no_goal(text):
    """A name alone, two bounds, or a bound that is no number are refused."""
    with pytest.raises(InputError, match=r"^goals: "):
        parse_goals([text])


@given(st.floats(-5, 5), st.floats(-5, 5), st.booleans())
def test_costs_are_smaller_where_values_are_better(first, second, larger):
    """The order of costs is that of values, reversed where larger values are better."""
    goal = Goal(name="a", larger=larger, bound=0.0)

    cost = goal.cost(np.array([first, second, np.nan]))

    assert (cost[0] < cost[1]) == (first > second if larger else first < second)
    assert cost[2] == np.inf
    assert not goal.is_reached(np.array([np.nan, 0.0])).any()


@given(costs)
def test_the_front_has_what_nothing_surpasses(rows):
    """By the definition, pair by pair; and a finite candidate off the front is surpassed by it."""
    cost = np.array(rows)

    front = on_front(cost)

    def surpasses(a, b):
        return all(x <= y for x, y in zip(a, b, strict=True)) and tuple(a) != tuple(b)

    for number, row in enumerate(rows):
        better = [other for other in rows if surpasses(other, row)]
        assert surpassed_by(cost)[number] == len(better)
        assert front[number] == (np.isfinite(row).all() and not better)
        if np.isfinite(row).all() and not front[number]:
            assert any(surpasses(other, row) for other in cost[front])


def _dense_square(log, cues, center):
    """Expected mean square error by one inverse of the whole information matrix, row by row."""
    rows = measure(log, cues).associated(center).averaged()
    count = log.robot_count
    jacobian = rows.jacobian(center).toarray()
    information = np.zeros((jacobian.shape[1],) * 2)
    for row, variance in zip(jacobian, rows.variance(), strict=True):
        information += np.outer(row, row) / variance
    information = information[: 3 * count, : 3 * count]
    extent = (center - center.mean(axis=0)).var(axis=0).sum()
    information += np.eye(3 * count) / max(extent, SPACING**2)
    pairs = zip(rows.robot, rows.neighbor, rows.distances.length, strict=False)
    for i, j, length in pairs:
        weight = 3.0 / max(length, SPACING) ** 2
        for axis in range(3):
            bond = np.zeros(3 * count)
            bond[3 * i + axis] = 1.0
            bond[3 * j + axis] = -1.0
            information += weight * np.outer(bond, bond)
    return np.trace(np.linalg.inv(information[3:, 3:])) / count


def test_the_expected_error_is_that_of_a_dense_solve(towers):
    """The sum over robots and axes of the inverse of the information matrix, by a slow sum."""
    history = towers[1]
    log = observe(history, SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0))
    cues = ("contacts", "ground", "height")

    expected = expected_square(log, cues, history.position)

    assert expected == pytest.approx(_dense_square(log, cues, history.position), rel=1e-6)


def test_predictions_average_over_structures_and_fall_with_precision(towers):
    """The RMSE is the root of the mean square of single structures; less noise predicts less."""
    base = load_scenario(BASE)
    candidates = list_candidates(base, {"sensing.tilt_noise_deg": [0.5, 4.0]}, None)

    together = predict(candidates, towers, lambda _: None)
    single = [predict(candidates, [history], lambda _: None) for history in towers]

    np.testing.assert_allclose(together, np.sqrt(np.mean(np.square(single), axis=0)))
    assert together[0] < together[1]


def test_wrong_contacts_count_as_missed():
    """A contact at a wrong dock is lost to a robust method, and a false one adds nothing."""
    sensing = SensingParams(missed_contacts=0.1, wrong_docks=0.2, false_contacts=0.3)

    right = without_errors(sensing)

    assert right.missed_contacts == pytest.approx(1.0 - 0.9 * 0.8)
    assert (right.wrong_docks, right.false_contacts) == (0.0, 0.0)


def test_structures_of_a_batch_are_those_that_grow_alone():
    """Thresholds, limits and patience of neighbors in a batch change no structure."""
    settings = [
        TowerParams(force_threshold=4.0),
        TowerParams(recruit_base=2.0, recruit_limit=1),
        TowerParams(climb=ClimbParams(patience=1)),
    ]
    assert len({batch_key(params) for params in settings}) == 1
    assert batch_key(TowerParams(movers=2)) != batch_key(TowerParams())
    assert batch_key(TowerParams(goal_height=9.0)) != batch_key(TowerParams())

    together = grow_each(settings, robots=12, seeds=[5, 6, 7], robot=RobotGeometry())

    for params, history in zip(settings, together, strict=True):
        [alone] = grow(params, robots=12, seeds=[history.seed], robot=RobotGeometry())
        np.testing.assert_array_equal(alone.position, history.position)
        np.testing.assert_array_equal(alone.peak_stress, history.peak_stress)


def test_seeds_of_search_and_of_verification_are_disjoint():
    """Even the most structures of a search end before the first fresh one."""
    assert FIRST_SEED + MOST_SEEDS <= FIRST_FRESH_SEED


def test_the_better_half_has_twice_as_many_structures():
    """Halving: of four settings two remain after two seeds, and the best after four."""
    base = load_scenario({**BASE, "robots": 6})
    patience = {"structure.climb.patience": [1, 2, 3, 4]}
    candidates = list_candidates(base, patience, None)
    goal = Goal(name="height_R", larger=True)

    result = search(base, candidates, "growth", [goal], seeds=8, threads=None, progress=Progress())

    assert sorted(result.structures) == [2, 2, 4, 8]
    best = result.order[0]
    assert result.structures[best] == 8
    assert result.front.tolist() == [number == best for number in range(4)]
    heights = tiswarm.grow(
        {"kind": "tower", "climb": {"patience": int(best) + 1}},
        robots=6,
        seeds=range(FIRST_SEED, FIRST_SEED + 8),
        quiet=True,
    ).height
    assert result.results["height_R"][best] == pytest.approx(heights.mean())


def test_prices_are_those_of_a_table_and_of_yaml(tmp_path):
    """Both forms and a dictionary price the same; 4 and 4.0 are one value, 1 and true are two."""
    table = tmp_path / "prices.csv"
    table.write_text(
        "key,value,price\nsensing.tilt_noise_deg,1,8\nsensing.tilt_noise_deg,4.0,1\n"
        "sensing.stances,true,2\nsensing.stances,false,0\nsensing.range_reach,null,0\n"
    )
    text = tmp_path / "prices.yaml"
    text.write_text(
        "sensing.tilt_noise_deg: {1: 8, 4.0: 1}\nsensing.stances: {true: 2, false: 0}\n"
        "sensing.range_reach: {null: 0}\n"
    )
    point = {"sensing.tilt_noise_deg": 4, "sensing.stances": True}

    for prices in (Prices.read(table), Prices.read(text), Prices.of(PRICES)):
        assert prices.of_values(point) == 3.0
    for prices in (Prices.read(table), Prices.read(text)):
        assert prices.of_values({"sensing.range_reach": None}) == 0.0
        with pytest.raises(InputError, match=r"sensing.stances: the value 1.0 has no price"):
            prices.of_values({"sensing.stances": 1})


def test_candidates_are_all_combinations_of_a_suite():
    """Settings that a suite brings stay with it, and the last key changes fastest."""
    vary = {"sensing.suite": ["fireant-v3", "kilobot"], "sensing.tilt_noise_deg": [1.0, 2.0]}

    candidates = list_candidates(load_scenario({**BASE, "sensing": {}}), vary, None)

    assert [tuple(one.point.values()) for one in candidates] == [
        ("fireant-v3", 1.0), ("fireant-v3", 2.0), ("kilobot", 1.0), ("kilobot", 2.0),
    ]  # fmt: skip
    kilobot = SensingParams(suite="kilobot", tilt_noise_deg=2.0)
    assert candidates[3].settings.sensing == kilobot
    assert isinstance(candidates[0], Candidate)


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """A design of four suites with prices, and its folder."""
    out = tmp_path_factory.mktemp("design") / "out"
    design = tiswarm.design(BASE, "rmse_R<9", TILTS, PRICES, seeds=2, fresh=2, out=out, quiet=True)
    return design, out


def test_a_design_writes_the_cheapest_suite_that_reaches_its_goal(designed):
    """design.yaml runs on the fresh seeds; design.csv has all candidates and what was found."""
    design, out = designed
    table = pd.read_csv(out / "design.csv")

    scenario = yaml.safe_load((out / "design.yaml").read_text())

    assert load_scenario(scenario) == load_scenario(dict(design.scenario))
    assert scenario["sensing"]["tilt_noise_deg"] == 4.0
    assert scenario["sensing"]["stances"] is False
    assert scenario["seeds"] == {"first": FIRST_FRESH_SEED, "count": 2}
    assert table["price"].tolist() == sorted(table["price"])
    assert len(table) == 4
    assert len(design.verified) == int(table["front"].sum())
    assert "seeds 2000000 to 2000001" in str(design)
    assert "seeds 3000000 to 3000001" in str(design)


def test_what_a_design_found_is_what_its_scenario_gives(designed, tmp_path):
    """The found RMSE of the best is the root mean square of a run of design.yaml."""
    design, out = designed

    run = tiswarm.run(out / "design.yaml", out=tmp_path, pictures=False, quiet=True)

    rmse = np.sqrt((run.summary["rmse_R"] ** 2).mean())
    assert design.table["found_rmse_R"][0] == pytest.approx(rmse)
    assert design.table["found_reaches"][0] == (rmse < 9)
    again = tiswarm.run(out / "design.yaml", out=out, pictures=False, quiet=True)
    assert sorted(path.name for path in out.glob("task-design-1-*")) == [again.folder.name]


def test_a_design_of_growth_needs_no_folder():
    """Without `out` nothing is written; predicted beside found heights are tabulated."""
    vary = {"structure.force_threshold": [5.0, 20.0], "structure.movers": [1, 2]}

    design = tiswarm.design(
        {**BASE, "localization": {"method": "none"}},
        ["height_R>1", "min:tries_per_robot"],
        vary,
        seeds=2,
        fresh=2,
        quiet=True,
    )

    assert design.folder is None
    assert design.table["reaches"].all()
    assert design.verified["found_height_R"].notna().all()
    assert design.scenario["structure"]["movers"] == int(design.table["structure.movers"][0])
    front = design.front[["predicted_height_R", "predicted_tries_per_robot"]].to_numpy()
    assert on_front(front * [-1, 1]).all()


BAD = [
    ({"goals": "rmse<1"}, "goals: there is no 'rmse'; choose one of rmse_R, price; did you mean"),
    ({"goals": "height_R>1"}, "goals: height_R: sensors do not change it"),
    ({"goals": "price<3"}, "goals: price: needs prices"),
    ({"goals": []}, "goals: is missing"),
    ({"goals": ["rmse_R<1", "min:rmse_R"]}, "goals: two goals are of rmse_R"),
    ({"goals": "rmse_R<1e-9"}, "goals: no candidate of 2 reaches rmse_R<1e-09; the best has"),
    ({"vary": {}}, "vary: is missing"),
    ({"vary": {"sensing.tilt": [1]}}, "vary: sensing.tilt: unknown key"),
    ({"vary": {"sensing.stances": [3]}}, "vary: sensing.stances[0]: 3 should be"),
    ({"vary": {"localization.chains": [3]}}, "vary: localization.chains: vary robots, or keys"),
    ({"vary": {"sensing.drift": [0.1]}}, "vary: sensing.drift: logs do not state"),
    ({"vary": {"robots": [8], "sensing.stances": [True]}}, "vary: sensing.stances: vary sensing"),
    ({"goals": "rmse_R<1", "vary": {"robots": [8]}}, "goals: rmse_R: is a goal of sensors"),
    ({"prices": {"sensing.stances": {True: 1}}}, "prices: sensing.tilt_noise_deg: the value 1.0"),
    ({"prices": {"sensing.stances": {True: -1}}}, "prices: sensing.stances: the price -1"),
    ({"seeds": 0}, "seeds: 0 should be from 1 to 10,000"),
    ({"fresh": 10**6}, "fresh: 1000000 should be"),
    ({"condition": "no"}, "condition: there is no 'no'"),
    ({"overrides": {"robots": 2000}}, "robots: errors are predicted for up to 1000 robots"),
    ({"overrides": {"localization": {"method": "none"}}}, "localization.method: none has no rmse"),
    ({"overrides": {"sweep": {"robots": [5, 6]}}}, "sweep: a design varies keys of its own"),
    ({"goals": "min:least_margin", "vary": {"robots": [4, 5]}}, "goals: no structure of this scen"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message for _, message in BAD])
def test_a_mistake_ends_a_design_in_a_line_and_writes_nothing(changes, message, tmp_path):
    """Wrong goals, keys, values, prices and scenarios are refused by their argument."""
    arguments = {"goals": "rmse_R<9", "vary": {"sensing.tilt_noise_deg": [1.0, 2.0]}}

    with pytest.raises(InputError) as refused:
        tiswarm.design(BASE, **{**arguments, **changes}, out=tmp_path / "out", quiet=True)

    assert str(refused.value).startswith(message)
    assert not (tmp_path / "out").exists()
