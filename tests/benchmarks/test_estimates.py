"""Generated logs are right and repeat, lies do what they say, and grades say who is silent."""

from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.estimates import assembly, lies, sets
from benchmarks.estimates.grade import (
    Bound,
    Grade,
    as_claimed,
    bound,
    grade,
    is_beacon,
    share,
    summary,
)
from benchmarks.estimates.sets import NONE, SETS, TRAINING, Case
from benchmarks.logs.grade import claims
from tests.benchmarks.commands import call
from tests.structures import exact_estimate
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.measurements.observability import observability
from tiswarm.records.estimate import Convergence

SPACING = 2.0
SURELY = 5.0
"""Standard deviations that chance does not exceed."""

GOOD = Convergence(converged=True, consistent=True, misfit_sd=0.0, chains=1, restarted=0)
PLANS = {
    "ring": assembly.ring,
    "star": assembly.star,
    "ladder": assembly.ladder,
    "arch": assembly.arch,
    "lattice": lambda robots, rng: assembly.lattice(robots, 4, rng),
}


@pytest.fixture(scope="module")
def ladder():
    """Build a ladder of 40 robots, without noise."""
    rng = np.random.default_rng(1)
    return assembly.built(assembly.ladder(40, rng), 4, rng)


def rng():
    """Start the random numbers of a lie."""
    return np.random.default_rng(7)


def docks(log, truth):
    """Compute the true place of each dock, shape (N, docks, 3)."""
    turn = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    return truth[:, None] + np.stack([turn.apply(arm) for arm in log.dock_offset_body], axis=1)


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("robots", [10, 31])
def test_robots_touch_as_planned_and_nowhere_else(name, robots):
    """Docks of contacts are D apart, and all others of two robots are farther."""
    random = np.random.default_rng(robots)
    plan = PLANS[name](robots, random)

    log, truth = assembly.built(plan, 4, random)

    point = docks(log, truth)
    i, a, j, b = log.contacts.T
    assert_allclose(np.linalg.norm(point[i, a] - point[j, b], axis=1), SPACING, atol=1e-7)
    near = cKDTree(point.reshape(-1, 3)).query_pairs(SPACING + 0.02, output_type="ndarray") // 4
    near = near[near[:, 0] != near[:, 1]]
    assert len(near) == len(log.contacts) == len(plan.pairs)
    assert not observability(log, cue_names(), truth).disconnected.any()
    if plan.planar:
        assert_array_equal(truth[:, 1], 0.0)
        assert lies.is_planar(log)


@pytest.mark.parametrize("name", SETS)
def test_a_log_repeats_from_its_set_and_number(name):
    """Other numbers give other logs."""
    _, make = SETS[name]
    number = 1 if name == "home" else 11

    first, again, other = make(number), make(number), make(TRAINING + number)

    assert_array_equal(first.truth, again.truth)
    for field in fields(first.log):
        mine, its = (getattr(case.log, field.name) for case in (first, again))
        if isinstance(mine, np.ndarray):
            assert_array_equal(mine, its)
    assert first.truth.shape != other.truth.shape or not np.allclose(first.truth, other.truth)


def test_half_of_the_generated_logs_have_a_lie():
    """Each lie is among the first 160, over several kinds."""
    number = np.arange(160)

    named = [
        list(lies.LIES)[(10 * (n // 20) + n % 10) % len(lies.LIES)]
        for n in number[number // 10 % 2 == 1]
    ]

    assert len(named) == 80
    assert min(named.count(lie) for lie in lies.LIES) >= 7


@pytest.mark.parametrize("number", [*range(10)])
def test_noise_explains_what_true_positions_leave(number):
    """Without a lie, residuals at the truth have the variance that the log states, or less."""
    case = sets.generated(TRAINING + number)

    rows = measure(case.log, cue_names())
    off = rows.residual(case.truth) / np.sqrt(rows.variance())

    assert case.lie == NONE
    assert np.abs(off).max() < 2.0 * SURELY
    # Residuals of an orientation are related: several rows have its error.
    assert np.mean(off**2) < 1.0 + SURELY * np.sqrt(2.0 / case.log.robot_count)


@pytest.mark.parametrize("lie", [*lies.LIES])
def test_a_lie_changes_what_it_names_alone(lie, ladder):
    """All other fields of the log stay."""
    changed = {
        "orientations off": {"orientation_wxyz"},
        "yaw off": {"orientation_wxyz"},
        "noise understated": {"noise"},
        "biased ranges": {"ranges"},
        "mute robots": {"orientation_wxyz", "contacts"},
    }
    log, truth = sets.noisy(ladder, rng(), tilt_deg=1.0, yaw_deg=2.0, heights=False)

    wrong = lies.LIES[lie](log, truth, rng())

    found = set()
    for field in fields(log):
        mine, its = getattr(log, field.name), getattr(wrong, field.name)
        same = (
            np.array_equal(mine, its, equal_nan=True)
            if isinstance(mine, np.ndarray)
            else mine == its
        )
        found |= set() if same else {field.name}
    assert found == changed.get(lie, {"contacts"})


def test_lies_are_as_large_as_they_say(ladder):
    """A tenth of the orientations is off by 20 deg, a fifth of the contacts is missed."""
    log, truth = ladder
    turn = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)

    wrong = lies.wrong_orientations(log, truth, rng())
    angle = (turn.inv() * Rotation.from_quat(wrong.orientation_wxyz, scalar_first=True)).magnitude()
    assert_allclose(np.sort(angle)[-4:], np.radians(20.0))
    assert_allclose(np.sort(angle)[:-4], 0.0, atol=1e-7)
    missed = lies.missed_contacts(log, truth, rng())
    assert len(missed.contacts) == len(log.contacts) - round(0.2 * len(log.contacts))
    mute = lies.mute_robots(log, truth, rng())
    silent = np.flatnonzero(np.isnan(mute.orientation_wxyz[:, 0]))
    assert len(silent) == 4
    assert not np.isin(mute.contacts[:, 2], silent).any()
    biased = lies.biased_ranges(log, truth, rng()).ranges
    far = np.linalg.norm(truth[biased[:, 0].astype(int)] - truth[biased[:, 1].astype(int)], axis=1)
    assert 0.3 < np.mean(biased[:, 2] - far) < 1.0
    false = lies.false_contacts(log, truth, rng())
    assert len(false.contacts) == len(log.contacts) + 2 + len(log.contacts) // 20


def test_exchanged_names_are_those_of_two_robots(ladder):
    """What later robots sensed of one is said of the other, and nothing else changes."""
    log, truth = ladder

    wrong = lies.exchanged_names(log, truth, rng())

    before, after = (set(map(tuple, each.contacts.tolist())) for each in (log, wrong))
    names = {row[0] for row in before - after} | {row[0] for row in after - before}
    assert len(after) == len(before)
    assert len(names) == 2
    assert {row[1:] for row in before - after} == {row[1:] for row in after - before}


def test_a_part_is_cut_off_or_tied_by_a_wrong_contact(ladder):
    """Without ties a part is disconnected; a wrong tie names robots that do not touch."""
    log, truth = ladder

    cut = lies.cut_off(log, truth, rng())
    torn = lies.wrong_tie(log, truth, rng())

    gone = observability(cut, cue_names(), truth).disconnected
    assert 0 < gone.sum() < len(truth)
    assert_array_equal(gone, lies.part_behind(log, rng()))
    crossing = torn.contacts[gone[torn.contacts[:, 0]] != gone[torn.contacts[:, 2]]]
    assert len(crossing) == 1
    assert crossing[0, [0, 2]].tolist() not in log.contacts[:, [0, 2]].tolist()


def test_readings_of_a_pair_share_a_bias_in_most_logs():
    """Means of many readings are off by more than chance where pairs are biased."""
    for number in range(8):
        case = sets.readings(TRAINING + number)
        robot, other, length = case.log.ranges[:, :3].T
        pair = robot * len(case.truth) + other
        true = np.linalg.norm(case.truth[robot.astype(int)] - case.truth[other.astype(int)], axis=1)
        off = pd.Series(length - true).groupby(pair)
        z = off.mean() / (sets.READING_SD / np.sqrt(off.count()))

        limit = 1.0 + SURELY * np.sqrt(2.0 / len(z))
        assert (np.mean(z**2) > limit) == (case.lie != NONE)


@pytest.mark.parametrize("number", range(8))
def test_beacons_leave_tags_a_motion(number):
    """One leaves spheres, two and a line leave circles, and a plane leaves mirror images."""
    case = sets.circles(number)
    beacon = is_beacon(case.log)
    arm = case.truth[beacon] - case.truth[0]

    assert np.linalg.matrix_rank(arm, tol=1e-9) == min(number % 4, 1 + (number % 4 == 3))
    assert not is_beacon(case.log)[beacon.sum() :].any()


def half_right(case, off, sd):
    """Estimate the truth, moved by `off` [log unit], with one sd for all."""
    robots = len(case.truth)
    return exact_estimate(
        case.log, case.truth + np.array([off, 0.0, 0.0]), sd=np.full(robots, sd), convergence=GOOD
    )


def graded(case, estimate):
    """Grade an estimate as of a log that determines all robots."""
    tied = ~is_beacon(case.log)
    limits = Bound(tied=tied, determined=tied, optimum_rmse=1.0)
    return grade(case, limits, estimate, name="a", number=0, method="m", cpu_s=1.0)


def test_an_estimate_is_silent_if_it_is_wrong_and_trusted(ladder):
    """A warning, a large sd, or no claim at all is not silence."""
    case = Case(kind="ladder", lie=NONE, log=ladder[0], truth=ladder[1])
    wrong = half_right(case, 1.0, 0.1)
    warned = replace(wrong, convergence=replace(GOOD, converged=False))
    unclaimed = replace(wrong, disconnected=np.ones(40, np.bool_))

    silent = graded(case, wrong)
    assert (silent.silent, silent.beyond, silent.said_or_right) == (True, True, False)
    assert silent.nees == pytest.approx(100.0, rel=0.02)
    assert silent.rmse == silent.over_optimum == pytest.approx(1.0, rel=1e-3)
    for estimate in (half_right(case, 1.0, 1.0), warned, unclaimed):
        found = graded(case, estimate)
        assert (found.silent, found.beyond, found.said_or_right) == (False, False, True)


def test_methods_claim_what_they_locate(ladder):
    """Robots with an open coordinate, an open sd, or without a tie are not claimed."""
    log, truth = ladder
    sd, open_axes, apart = np.ones(40), np.zeros((40, 3), np.bool_), np.zeros(40, np.bool_)
    sd[1], open_axes[2, 0], apart[3] = np.inf, True, True

    found = claims(exact_estimate(log, truth, sd=sd, undetermined=open_axes, disconnected=apart))

    assert np.flatnonzero(~found).tolist() == [1, 2, 3]


def test_arbitrary_motions_do_not_count():
    """A turned or mirrored estimate that says so is graded as moved back."""
    case = sets.circles(0)
    turn = Rotation.from_euler("xyz", [0.3, 1.0, -2.0])
    turned = turn.apply(case.truth * [1.0, 1.0, -1.0])
    estimate = exact_estimate(case.log, turned, free_frame=("rotation", "hand"))

    assert_allclose(as_claimed(case.log, estimate, case.truth), case.truth, atol=1e-9)
    estimate = replace(estimate, free_frame=())
    assert_allclose(as_claimed(case.log, estimate, case.truth), turned)

    case = sets.circles(1)
    [axis] = case.truth[is_beacon(case.log)][1:] / np.linalg.norm(case.truth[1])
    turned = Rotation.from_rotvec(2.0 * axis).apply(case.truth)
    estimate = exact_estimate(case.log, turned, free_frame=("axis", "hand"))
    assert_allclose(as_claimed(case.log, estimate, case.truth), case.truth, atol=1e-9)


def test_exact_ranges_determine_tags():
    """The least cost from the truth is at the truth; beacons do not count."""
    case = sets.cases(TRAINING - TRAINING % 7)

    found = bound(case)

    assert case.kind == "room"
    assert_array_equal(found.determined, ~is_beacon(case.log))
    assert_array_equal(found.tied, found.determined)
    assert found.optimum_rmse < 1e-3


def test_shares_are_of_trusted_logs():
    """Logs that a method refuses do not count."""
    each = {"set": "a", "method": "m", "kind": "k", "lie": NONE, "robots": 3}
    grades = [
        Grade(**each, number=0, trusted=True, silent=True, beyond=True, nees=3.0, rmse=2.0),
        Grade(**each, number=1, trusted=True, nees=1.0, rmse=1.0),
        Grade(**each, number=2, rmse=6.0),
        Grade(**each, number=3, refused="no compass"),
    ]

    [row] = summary(pd.DataFrame(grades), ["set", "method"]).to_dict("records")

    assert (row["logs"], row["trusted"]) == (3, 2)
    assert row["silent"] == row["beyond_5_sd"] == share(1, 2)
    assert share(15, 143) == "15 (10 %, 6-17)"
    assert (row["nees"], row["median_R"], row["mean_R"]) == (2.0, 2.0, 3.0)


@pytest.mark.trial
def test_the_command_writes_a_row_a_log_and_method(tmp_path):
    """The table by kind and lie is beside that of sets."""
    done = call(
        "estimates", "cases", "circles", "--logs", 2, "--training", "--by", "kind",
        "--methods", "hop-by-hop", "least-squares", "--out", tmp_path,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "grades.csv")
    assert table["number"].tolist() == [100000, 100000, 100001, 100001] * 2
    assert (tmp_path / "summary-set-method.csv").exists()
    assert (tmp_path / "summary-set-kind-method.csv").exists()
