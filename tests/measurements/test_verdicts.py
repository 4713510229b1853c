"""Lines on an estimate say whether to trust it and why, and name robots, lines and remedies."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.structures import exact_estimate
from tiswarm.base.errors import InputError
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.measurements.verdicts import (
    MOST_SHOWN,
    cautions,
    describe_outliers,
    describe_solutions,
    distrust,
    in_brief,
    reasons,
    verdict,
)
from tiswarm.records.estimate import MOST_MISFIT_SD, Convergence, Observability, OpenTurn, Solution
from tiswarm.records.messages import percent
from tiswarm.sensing import SensingParams, observe

LOG = Path("log.jsonl")
GOOD = Convergence(converged=True, consistent=True, misfit_sd=-0.3, chains=8, restarted=0)
LOST = replace(GOOD, converged=False, reason="30 % of the contacts are outliers")
AT_ODDS = replace(
    GOOD, consistent=False, misfit_sd=27.2, sd_factor=3.08, reason="noise does not explain it"
)


@pytest.fixture(scope="module")
def log(towers):
    """What thirty robots sensed, with names from 100 on."""
    sensed = observe(towers[0], SensingParams())
    return replace(sensed, robot_id=sensed.robot_id + 100)


@pytest.fixture(scope="module")
def estimate(log, towers):
    """An estimate that is right and trusted."""
    return exact_estimate(
        log, towers[0].position, sd=np.full(30, 0.1), convergence=GOOD,
        iteration=np.empty(0, np.int64), trace=np.empty((0, 30, 3)), residual=np.empty(0),
    )  # fmt: skip


def _solution(weight, chi_square=1.0, chains=1, off=None):
    """A configuration in which some robots, given by index, stand away from the others."""
    position = np.zeros((30, 3))
    position[[*(off or {})], 1] = [*(off or {}).values()]
    return Solution(
        weight=weight, chi_square=chi_square, chains=chains, residual=0.1, residual_sd=1.0,
        position=position, sd=np.full(30, 0.5),
    )  # fmt: skip


def _which(*robots):
    return np.isin(np.arange(30), robots)


def test_good_verdicts_are_no_reason_and_several_configurations_are(log, estimate):
    """Only what limits an estimate is a reason."""
    several = tuple(_solution(weight) for weight in (0.714, 0.2, 0.086))
    mirrored = replace(estimate, solutions=several, mirrored=_which(4, 7, 9))
    single = replace(estimate, solutions=several[:1], mirrored=_which())

    lines = [in_brief(log, each) for each in (mirrored, single, estimate)]

    assert lines == [
        "3 configurations fit, the likeliest has 71 %; mirrored: 3 robots (104, 107, 109)",
        "",
        "",
    ]
    assert [*reasons(log, mirrored)] == ["3 configurations fit, the likeliest has 71 %"]
    assert distrust(log, mirrored) == ""


def test_an_estimate_is_not_called_consistent_where_nothing_could_show_that_it_is_not(
    log, estimate
):
    """As few spare measurements as these fit any lie."""
    few = replace(GOOD, testable=False, spare=28)

    assert [*reasons(log, replace(estimate, convergence=few))] == [
        "consistency not testable (28 spare measurements: too few to disagree)"
    ]
    assert in_brief(log, replace(estimate, convergence=replace(few, spare=1))).endswith(
        "(1 spare measurement: too few to disagree)"
    )
    assert distrust(log, replace(estimate, convergence=few)) == ""


def test_an_estimate_that_did_not_converge_states_the_reason_that_the_method_gave(log, estimate):
    """A chi-square as expected is not the reason, so that the line does not contain it."""
    lost = replace(estimate, convergence=LOST)

    assert in_brief(log, lost) == "not converged"
    assert distrust(log, lost) == (
        "not converged: 30 % of the contacts are outliers; positions and sd may be far off; try "
        "twice the steps or chains, or another seed; if that does not help, look for wrong "
        "measurements"
    )
    assert verdict(lost) == "not converged"


def test_robots_that_carry_the_chi_square_are_named_only_of_a_search_that_converged(log, estimate):
    """Where it stopped short, they say where it stopped, not which measurements are wrong."""
    misfit = np.where(_which(12, 13, 20), [90.0], [2.0])
    lost = replace(AT_ODDS, converged=False)

    text = distrust(log, replace(estimate, convergence=lost, misfit=misfit))

    assert text.startswith("neither converged nor consistent")
    assert "carried by" not in text


def test_measurements_that_are_not_consistent_name_the_robots_that_carry_it(log, estimate):
    """Three robots carry more than half, so that these are what to look at."""
    misfit = np.where(_which(12, 13, 20), [90.0], [2.0])
    found = replace(estimate, convergence=AT_ODDS, misfit=misfit)

    text = distrust(log, found)

    assert text == (
        "not consistent: noise does not explain it (chi-square exceeds its expectation by 27 sd); "
        "sd is multiplied by 3.1; most of it is carried by 2 robots (112, 113); look at the "
        "measurements of these robots, or leave them out"
    )
    assert in_brief(log, found) == "not consistent"


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"misfit": np.full(30, 9.0)}, "correct its dock_radius and dock_offsets"),
        ({"convergence": replace(AT_ODDS, misfit_sd=-9.0)}, "state smaller noise in the log"),
        ({"convergence": replace(AT_ODDS, chains=1)}, "localize by joint, with several chains"),
        ({"convergence": replace(LOST, chains=1)}, "localize by joint, with several chains"),
    ],
    ids=["spread-over-all", "too-good", "one-start-misfits", "one-start-is-lost"],
)
def test_the_remedy_fits_what_is_wrong(changes, remedy, log, estimate):
    """A misfit of all robots is in the header; a single start may have missed the least cost."""
    text = distrust(log, replace(estimate, **({"convergence": AT_ODDS} | changes)))

    assert text.endswith(remedy)
    assert "carried by" not in text


def test_robots_beyond_their_contacts_are_where_to_look(log, estimate):
    """Contacts with wrong robots leave such gaps, with a verdict and without one."""
    position = np.where(_which(7)[:, None], 1e6, estimate.position)
    lost = replace(estimate, position=position, convergence=LOST)

    text, without = (distrust(log, each) for each in (lost, replace(lost, convergence=None)))

    assert text.endswith("look for wrong contacts, heights and spawn positions of 1 robot (107)")
    assert without.startswith(
        "not converged: beyond the reach of their contacts are 1 robot (107); look for wrong "
    )
    assert in_brief(log, lost) == in_brief(log, replace(lost, convergence=None)) == "not converged"
    assert in_brief(log, replace(estimate, convergence=None)) == ""


@given(
    misfit=st.floats(-50.0, 50.0),
    verdicts=st.tuples(st.booleans(), st.booleans()),
    factor=st.sampled_from([1.0, 2.5]),
)
def test_chi_square_is_blamed_only_where_it_is_at_fault(log, estimate, misfit, verdicts, factor):
    """No line says that chi-square exceeds its expectation by -0 sd."""
    converged, consistent = verdicts
    found = replace(
        GOOD, converged=converged, consistent=consistent, misfit_sd=misfit, sd_factor=factor
    )

    text = distrust(log, replace(estimate, convergence=found))

    blamed = not consistent and abs(misfit) > MOST_MISFIT_SD
    assert ("chi-square" in text) == blamed
    assert (f"exceeds its expectation by {misfit:.0f} sd" in text) == (blamed and misfit > 0)
    assert (text == "") == found.trusted


def test_cautions_say_which_robots_are_mirrored_and_that_the_frame_is_arbitrary(log, estimate):
    """Both may hold of an estimate that is trusted."""
    found = replace(estimate, mirrored=_which(3), free_frame=("rotation", "hand"))

    mirrored, frame = cautions(log, found)

    assert mirrored.startswith("mirrored: 1 robot (103); configurations that fit")
    assert frame == (
        "frame arbitrary: no measurement would change if all robots turned about the anchor or "
        "were replaced by their mirror image; sd_R is that of the shape"
    )
    assert [*cautions(log, estimate)] == []


def test_no_sentence_calls_a_robot_that_left_mirrored(log, estimate):
    """Nobody can measure it; distances between solutions are those of robots that remain."""
    left = replace(log, gone=np.array([3, 7]))
    solutions = (_solution(0.7), _solution(0.3, off={3: 7.0, 9: 5.0}))
    found = replace(estimate, solutions=solutions, mirrored=_which(3, 7, 9))

    assert in_brief(left, found).endswith("mirrored: 1 robot (109)")
    assert [text.partition(";")[0] for text in cautions(left, found)] == ["mirrored: 1 robot (109)"]
    assert "up to 5 R from solution 1: 1 robot (109)" in [*describe_solutions(left, found)][1]
    assert [*cautions(left, replace(found, mirrored=_which(3, 7)))] == []
    assert not in_brief(left, replace(found, mirrored=_which(3, 7))).count("mirrored")


def test_cautions_name_robots_that_outliers_alone_tie(log, estimate):
    """The log itself ties them: what cues determine does not show it."""
    known = Observability(
        cues=("contacts",), yaw_unknown=False, unknowns=87, gauge_yaw_sd=None, floppy_modes=0,
        floppy=_which(), disconnected=_which(9),
    )  # fmt: skip
    found = replace(
        estimate,
        observability=known,
        disconnected=_which(4, 9),
        outlier_contacts=np.zeros((1, 5), np.int64),
    )

    assert [*cautions(log, found)] == [
        (
            "only outliers tie 1 robot (104) to the anchor (positions are guesses); look at the "
            "contacts and ranges of these robots"
        )
    ]
    assert found.known[4] == found.known[9] == "disconnected"
    assert [*cautions(log, replace(found, outlier_contacts=None))] == []


@pytest.mark.parametrize("floppy", [0, 14, 15, 29])
def test_an_estimate_that_leaves_most_robots_open_says_so(log, estimate, floppy):
    """From half of the robots beside the anchor on; those that turn freely are named elsewhere."""
    known = Observability(
        cues=(), yaw_unknown=False, unknowns=87, gauge_yaw_sd=None, floppy_modes=floppy,
        floppy=_which(*range(1, 1 + floppy)), disconnected=_which(),
    )  # fmt: skip
    turn = OpenTurn(
        robots=np.arange(1, 1 + floppy), about=np.zeros(1, int), axis=None, place=np.zeros((30, 3))
    )
    found = replace(estimate, observability=known)

    texts = [*cautions(log, found)]

    assert len(texts) == (floppy > 14)
    for text in texts:
        assert text.startswith(f"measurements do not determine where {floppy} of 30 robots are: ")
        assert text.partition(": ")[0] in in_brief(log, found)
    (turning,) = cautions(log, replace(found, turns=(turn,)))
    assert turning.startswith("free to turn about every axis through robot 100: ")


def test_each_solution_is_listed_with_its_weight_and_where_it_differs(log, estimate):
    """Robots that stand elsewhere come farthest first."""
    found = (
        _solution(0.7, 3.0, 2),
        _solution(0.3, 4.7, 1, {4: 2.5, 7: 5.0, 9: 1.9}),
    )

    assert [*describe_solutions(log, replace(estimate, solutions=found))] == [
        "solution 1 of 2, weight 70 %, 2 of 3 chains",
        (
            "solution 2 of 2, weight 30 %, chi-square +1.7, 1 of 3 chains; up to 5 R from solution "
            "1: 2 robots (107, 104)"
        ),
    ]
    assert [*describe_solutions(log, replace(estimate, solutions=found[:1]))] == []


def test_a_method_without_a_chi_square_lists_none(log, estimate):
    """Its solutions have chains and weights alone."""
    found = (_solution(0.5, np.nan), _solution(0.5, np.nan, off={3: 3.0}))

    lines = [*describe_solutions(log, replace(estimate, solutions=found))]

    assert "chi-square" not in "".join(lines)
    assert lines[1].endswith(": 1 robot (103)")


def test_long_lists_are_cut(log, estimate):
    """The last line counts the rest."""
    many = tuple(_solution(0.1, k, off=dict.fromkeys(range(1, k + 1), 3.0)) for k in range(12))

    lines = [*describe_solutions(log, replace(estimate, solutions=many))]

    assert len(lines) == MOST_SHOWN + 1
    assert lines[-1] == f"{12 - MOST_SHOWN} more solutions"


def test_a_solution_takes_the_place_of_the_mean(log, estimate):
    """It has its own standard deviation; a number that no solution has is refused."""
    trace = np.zeros((1, 30, 3))
    solutions = (_solution(0.7), _solution(0.3, off={3: 7.0}))
    found = replace(estimate, solutions=solutions, trace=trace, mirrored=_which(3))

    chosen = found.with_solution(2)

    np.testing.assert_array_equal(chosen.position, solutions[1].position)
    np.testing.assert_array_equal(chosen.sd, np.full(30, 0.5))
    assert [*cautions(log, chosen)] == []
    for number in (0, 3):
        with pytest.raises(
            InputError, match=f"{number}: the method found 2 solutions; choose 1 to 2"
        ):
            found.with_solution(number)
    with pytest.raises(InputError, match="found 0 solutions; leave it out"):
        replace(found, solutions=()).with_solution(1)


@given(share=st.floats(0.0, 1.0))
def test_no_share_looks_like_all_or_none_that_is_not(share):
    """A likeliest solution of 99.99 % has others beside it."""
    text = percent(share)

    assert (text == "100") == (share == 1.0)
    assert (text == "0") == (share == 0.0)


def test_outliers_of_each_kind_are_named_with_their_line(log, estimate, towers):
    """A range names the other robot, a coordinate its axis, a robot its IMU."""
    fixes = np.array([[5, 1, 0, 0, 1e3, 0.1, -1], [5, 0, 1, 0, towers[0].position[5, 1], 0.1, -1]])
    high = np.where(_which(6), 1e3, log.flip_height)
    ranges, touches = np.array([[4, 2, 3.0, 0.1, -1]]), np.array([[4, -1, 2, 0]], np.int32)
    sensed = replace(
        log, fixes=fixes.astype(float), flip_height=high, ranges=ranges, touches=touches
    )
    flips = np.diff(sensed.stances.start)
    i, a, j, b = sensed.contacts[-1].tolist()
    found = replace(
        estimate,
        outlier_contacts=np.array(
            [[j, flips[j], b, i, a], [4, flips[4], -1, 2, -1], [4, flips[4], -2, 2, 0]]
        ),
        outlier_places=np.array([[5, flips[5], -1], [6, 0, -1]]),
        outlier_robots=np.array([12]),
    )

    lines = [*describe_outliers(sensed, LOG, found)]

    assert lines == [
        (
            f"log.jsonl:{j + 2}: contacts: robot {100 + j}'s contact [{b}, {100 + i}, {a}] is an "
            "outlier"
        ),
        "log.jsonl:6: ranges: robot 104's range to robot 102 is an outlier",
        "log.jsonl:6: touches: robot 104's touch of robot 102 is an outlier",
        "log.jsonl:7: fixes: robot 105's fix along x at 1000 R is an outlier",
        "log.jsonl:8: flip_height: robot 106's height is an outlier",
        (
            "log.jsonl:14: orientation_wxyz: robot 112's orientation is an outlier: its "
            "measurements all disagree; look at its IMU"
        ),
    ]


def test_outliers_of_earlier_stances_name_the_stance(log, estimate):
    """A height, which the robot has once, names none; a ground contact of a walk does."""
    start = log.stances.start
    stance, dock = next(
        row for row in log.stances.ground_docks.tolist() if row[0] not in set(start[1:] - 1)
    )
    robot = int(np.searchsorted(start, stance, side="right")) - 1
    at = stance - int(start[robot])
    found = replace(estimate, outlier_places=np.array([[robot, at, dock]]))

    lines = [*describe_outliers(log, LOG, found)]

    place = f"log.jsonl:{robot + 2}: stances[{at}].ground_docks"
    assert lines == [f"{place}: robot {100 + robot}'s ground contact of dock {dock} is an outlier"]


def test_every_kind_of_coordinate_has_a_name(log, estimate, towers):
    """No outlier is left out of the list because its cue is new."""
    spawned = observe(towers[0], SensingParams(spawn_noise=0.1))
    fixes = np.array([[5, 1.0, 0.0, 0.0, 1.0, 0.1, -1.0]])
    sensed = replace(spawned, fixes=fixes)
    rows = measure(sensed, cue_names())

    lines = [*describe_outliers(sensed, LOG, replace(estimate, outlier_places=rows.sensed_places))]

    assert len(lines) == len(rows.places.value)
