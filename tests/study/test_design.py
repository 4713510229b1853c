"""Designs predict errors as a dense solve does, and verify what nothing surpasses."""

from contextlib import suppress

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import tiswarm
from benchmarks.design import compare
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.cost.cost import HINGE_SD, STRAIN_SD
from tiswarm.localization.mixture.assessment import expected_square
from tiswarm.measurements.cues import Precision
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.design.candidates import PRICE, Candidate, list_candidates
from tiswarm.study.design.goals import Goal, on_front, parse_goal, parse_goals, surpassed_by
from tiswarm.study.design.prices import Prices
from tiswarm.study.design.search import (
    FIRST_FRESH_SEED,
    FIRST_SEED,
    MOST_SEEDS,
    better,
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


def _measured(log, center, turn):
    """Distances of docks in contact, and heights of docks on the ground [R], turned by (N, 3)."""
    dock = dock_offsets(log.orientation_wxyz, log.dock_offset_body) / log.dock_radius
    dock = np.stack([Rotation.from_rotvec(w).apply(arm) for w, arm in zip(turn, dock, strict=True)])
    dock += center[:, None]
    i, a, j, b = log.contacts.T
    distance = np.linalg.norm(dock[i, a] - dock[j, b], axis=1)
    return np.concatenate([distance, dock[log.ground_docks[:, 0], log.ground_docks[:, 1], 2]])


def _dense_square(log, center):
    """Mean square error of each robot, from finite differences and one dense inverse."""
    count = len(center)
    contacts = len(log.contacts)
    precision = Precision()
    turn_sd = np.radians([log.noise.tilt_deg, log.noise.tilt_deg, log.noise.yaw_deg])
    sd = np.repeat([precision.contact, precision.height], [contacts, len(log.ground_docks)])

    def weighed(unknowns):
        places, turns = unknowns.reshape(2, count, 3)
        turns = turns * turn_sd
        pairs = np.unique(log.contacts[:, [0, 2]], axis=0)
        hinges = (places[pairs[:, 0]] - places[pairs[:, 1]]).ravel() / HINGE_SD
        rows = _measured(log, places, turns) / sd
        return np.concatenate([rows, (turns / turn_sd).ravel(), hinges])

    at = np.concatenate([center.ravel(), np.zeros(3 * count)])
    step = 1e-6
    jacobian = np.stack(
        [
            (weighed(at + step * unit) - weighed(at - step * unit)) / (2.0 * step)
            for unit in np.eye(len(at))
        ],
        axis=1,
    )[:, 3:]  # the anchor stays
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    pairs = np.unique(log.contacts[:, [0, 2]], axis=0)
    strain = STRAIN_SD * (center[pairs[:, 0]] - center[pairs[:, 1]]).ravel() / HINGE_SD
    shared = covariance @ jacobian[len(jacobian) - len(strain) :].T @ strain
    square = (covariance.diagonal() + shared**2)[: 3 * count - 3].reshape(-1, 3).sum(axis=1)
    off = center - center.mean(axis=0)
    extent = (off**2).sum(axis=1) + (off**2).sum(axis=1).mean()
    return np.minimum(np.insert(square, 0, 0.0), extent)


def test_the_expected_error_is_that_of_a_dense_solve(towers):
    """Ours draws 64 errors of all measurements; the inverse of the whole matrix needs none."""
    history = towers[1]
    log = observe(history, SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0))

    expected = expected_square(log, ("contacts", "ground"), history.position)

    square = _dense_square(log, history.position)
    assert expected == pytest.approx(square.mean(), rel=0.3)


def test_a_robot_that_nothing_ties_may_be_anywhere(towers):
    """It is as far off as robots are from each other."""
    history = towers[1]
    log = observe(history, SensingParams(missed_contacts=1.0, heights=False))

    expected = expected_square(log, ("contacts",), history.position)

    off = ((history.position - history.position.mean(axis=0)) ** 2).sum(axis=1)
    assert expected == pytest.approx((off[1:].sum() + (len(off) - 1) * off.mean()) / len(off))


@pytest.mark.trial
def test_errors_of_runs_are_near_the_predicted_ones():
    """Robots of other structures, placed by `joint`, err as the information at the truth says."""
    kinds = {"tower": {"kind": "tower"}, "planar": {"kind": "tower", "plane": True}}
    suite = {"tilt_noise_deg": 2.0, "yaw_noise_deg": 5.0, "range_reach": 12.0, "range_noise": 0.3}

    tables = [compare(kind, [suite], robots=30, seeds=4) for kind in kinds.values()]

    ratio = pd.concat(tables)["found_R"] / pd.concat(tables)["predicted_R"]
    assert ((ratio > 1 / 1.5) & (ratio < 1.5)).all()


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


@given(st.lists(st.tuples(*[st.integers(0, 3)] * 2), min_size=1, max_size=9))
def test_halving_keeps_what_nothing_surpasses(results):
    """Half go on, and one of each result that reaches the bound and that no other surpasses."""
    height, stress = np.array(results, np.float64).T
    goals = [Goal(name="height_R", larger=True, bound=0.5), Goal(name="peak_stress", larger=False)]

    kept = better(goals, {"height_R": height, "peak_stress": stress, PRICE: np.zeros(len(results))})

    front = {
        (a, b)
        for a, b in results
        if a > 0 and not any(c >= a and d <= b and (c, d) != (a, b) for c, d in results)
    }
    assert front <= {results[k] for k in kept}
    half = (len(results) + 1) // 2
    assert half <= len(kept) <= half + len(front)


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
    ({"overrides": {"robots": 3001}}, "robots: errors are predicted for up to 3000 robots"),
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
