"""Every method knows where all anchors of a log are, and puts separate parts in one frame."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests import foreign
from tests.runs import REPOSITORY
from tests.structures import NOISY, grown
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.online.settings import OnlineParams
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import BackPropagation, JointParams, Together, VirtualForceParams
from tiswarm.localization.virtual_force.method import Localizer
from tiswarm.measurements.advice.further import advise, advise_together
from tiswarm.measurements.cues import cue_names
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_log import KNOWN_SD
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.navigation import _sides
from tiswarm.world.growth import grow
from tiswarm.world.params import CantileverParams, TowerParams

pytestmark = pytest.mark.unchecked

METHODS = {
    "joint": JointParams(chains=2, steps=400, hold_steps=100),
    "least-squares": LeastSquaresParams(),
    "hop-by-hop": HopByHopParams(),
    "online": OnlineParams(chains=1, steps=100, hold_steps=50),
    "virtual-force": VirtualForceParams(iterations=60),
    "back-propagation": VirtualForceParams(
        iterations=60, back_propagation=BackPropagation(sweeps=50)
    ),
    "together": VirtualForceParams(schedule="together", together=Together(steps=200)),
    "distributed": DistributedParams(chains=0),
    "algorithm-1": DistributedParams(scheme="algorithm-1"),
}
FIRM = 0.02
"""How far noise moves an anchor, whose position is a measurement, at most [R]."""


@pytest.fixture(scope="module")
def apart():
    """A cantilever of twelve robots, and an anchor 15 R away that nobody touches."""
    anchors = ((-1.6, 0.0), (-1.6, -15.0))
    [history] = grow(
        CantileverParams(anchors=anchors, spawn_width=0.0), robots=12, seeds=[2],
        robot=RobotGeometry(),
    )  # fmt: skip
    return history


@pytest.fixture(scope="module")
def parted():
    """A tower from anchors so far apart that its parts have not met."""
    anchors = ((0.0, 0.0), (14.0, 0.0), (0.0, 14.0))
    history = grown(TowerParams(anchors=anchors), robots=24, seed=1)
    assert len(set(_part_of(history))) > 1
    return history


def _part_of(history):
    """Least robot of the part that contacts connect each robot to."""
    part = list(range(history.robot_count))
    for _ in part:
        for i, _, j, _ in history.contacts.tolist():
            part[i] = part[j] = min(part[i], part[j])
    return part


@pytest.mark.parametrize("method", METHODS)
def test_no_part_with_an_anchor_is_a_guess(parted, method):
    """Anchors are at their places, and robots of each part near theirs, with noise."""
    log = observe(parted, NOISY)

    found = localize(log, METHODS[method])

    error = np.linalg.norm(found.position - parted.position, axis=1)
    assert error[:3].max() < FIRM
    assert error.max() < 10.0
    assert not found.disconnected.any()
    assert not found.observability.disconnected.any()
    assert "anchors" in found.observability.cues


@pytest.mark.parametrize("method", METHODS)
def test_an_anchor_that_nobody_touches_is_at_its_place(apart, method):
    """Its fixes alone say where it is."""
    log = observe(apart, SensingParams(tilt_noise_deg=1.0))
    alone = sorted({0, 1} - set(apart.contacts[:, 0].tolist()))
    assert alone

    found = localize(log, METHODS[method])

    error = np.linalg.norm(found.position - apart.position, axis=1)
    assert error[alone].max() < FIRM


@pytest.mark.parametrize("method", ["virtual-force", "back-propagation", "together"])
def test_virtual_forces_leave_anchors_where_they_are(parted, method):
    """To the last bit, in every frame, and without a step."""
    log = observe(parted, SensingParams(tilt_noise_deg=1.0))

    found = localize(log, METHODS[method])

    for frame in found.trace:
        np.testing.assert_allclose(frame[:3], parted.position[:3], rtol=0.0, atol=1e-12)
    assert found.steps[:3].tolist() == [0, 0, 0]
    assert (found.steps[3:] > 0).all()


def test_robots_that_join_one_by_one_end_where_the_log_puts_them(parted):
    """Bit for bit, anchors included."""
    log = observe(parted, SensingParams(tilt_noise_deg=1.0))
    header, *lines = log_entries(log)
    params = VirtualForceParams(iterations=60)
    swarm = Localizer(json.dumps(header), params)
    for line in lines:
        swarm.join(line)

    np.testing.assert_array_equal(swarm.positions, localize(log, params).position)


def test_a_log_with_one_anchor_has_no_rows_of_anchors(towers):
    """Fixes that are less precise, or along two axes, make no anchor."""
    log = observe(towers[0], SensingParams())
    seeds = observe(towers[0], SensingParams(seed_robots=3, fix_noise=0.01))
    two = replace(seeds, fixes=seeds.fixes[[0, 1]])
    two.fixes[:, 5] = KNOWN_SD

    found = localize_many(
        [log, seeds, two], [METHODS["least-squares"]] * 3, with_observability=True
    )

    assert ["anchors" in each.observability.cues for each in found] == [False] * 3
    assert ["fixes" in each.observability.cues for each in found] == [False, True, True]


def test_contacts_do_not_outvote_an_anchor(parted):
    """A robust loss lets measurements give way, but known positions never."""
    log, shift = observe(parted, SensingParams()), np.array([1.0, -2.0, 0.5])
    off = log.fixes.copy()
    off[:3, 4] += off[:3, 1:4] @ shift

    for method in ("joint", "least-squares", "online"):
        found = localize(replace(log, fixes=off), METHODS[method])
        np.testing.assert_allclose(found.position[1] - parted.position[1], shift, atol=0.05)


@pytest.mark.parametrize("method", ["joint", "least-squares", "hop-by-hop", "online"])
def test_many_readings_that_share_an_error_do_not_outvote_an_anchor(method):
    """Thirty ranges of each pair, all too long or all too short, pull at three anchors.

    The anchors stay within five sd of 0.001 dock radii, and none of their fixes is an outlier.
    """
    log, place = foreign.room_of_tags(foreign.ROOM, 2, count=4, sd=0.02)
    rng, readings = np.random.default_rng(0), np.repeat(log.ranges, 30, axis=0)
    bias = np.repeat(0.03 * rng.choice([-1.0, 1.0], len(log.ranges)), 30)
    readings[:, 2] += bias + 0.02 * rng.normal(size=len(readings))
    fixes = log.fixes.copy()
    fixes[:, 5] = KNOWN_SD * log.dock_radius

    found = localize(replace(log, ranges=readings, fixes=fixes), METHODS[method])

    moved = np.linalg.norm(found.position - place, axis=1)[:4] / log.dock_radius
    assert moved.max() < 5.0 * KNOWN_SD
    assert found.outlier_places is None or not len(found.outlier_places)


def known_room(seed):
    """Log four known anchors and tags that range to them; return true places, too."""
    log, place = foreign.room_of_tags(foreign.ROOM, seed, count=4, sd=0.02)
    fixes = log.fixes.copy()
    fixes[:, 5] = KNOWN_SD * log.dock_radius
    return replace(log, fixes=fixes), place


@pytest.mark.parametrize("method", ["joint", "least-squares", "hop-by-hop", "online"])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_misfit_of_an_anchor_that_stays_is_in_the_verdict(method, seed):
    """A wrong place misses ranges by 19 sd of these: no verdict is good, and no fix is an outlier.

    The right place is called consistent, and misfit is what noise explains: about a row each.
    """
    log, place = known_room(seed)
    shift, wrong = np.array([0.3, -0.2, 0.1]), log.fixes.copy()
    one = wrong[:, 0] == 1
    wrong[one, 4] += wrong[one, 1:4] @ shift

    right = localize(log, METHODS[method])
    found = localize(replace(log, fixes=wrong), METHODS[method])

    assert right.convergence.trusted
    rows = len(log.ranges) + len(log.fixes)
    assert right.misfit.sum() < rows + 5.0 * np.sqrt(2.0 * rows)
    np.testing.assert_allclose(found.position[1] - place[1], shift, atol=1e-3)
    assert not found.convergence.trusted
    # Ranges that are outliers carry no misfit.
    outliers = 0 if found.outlier_contacts is None else len(found.outlier_contacts)
    assert found.misfit.sum() > right.misfit.sum() or outliers
    assert found.outlier_places is None or not len(found.outlier_places)


@pytest.mark.parametrize("method", ["joint", "least-squares", "hop-by-hop", "online"])
def test_two_known_places_of_an_anchor_that_differ_are_not_consistent(method):
    """Neither is dropped: by hand, two at 2 d from each other carry 2 (d / sd)^2."""
    log, place = known_room(2)
    [again] = [log.fixes[log.fixes[:, 0] == 1].copy()]
    shift = 20.0 * KNOWN_SD * log.dock_radius * np.ones(3)
    again[:, 4] += again[:, 1:4] @ shift
    fixes = np.concatenate([log.fixes, again])
    twice = replace(log, fixes=fixes[np.argsort(fixes[:, 0], kind="stable")])

    found = localize(twice, METHODS[method])

    assert not found.convergence.consistent
    assert "scatter more than their stated noise" in found.convergence.reason
    np.testing.assert_allclose(found.position[1], place[1] + 0.5 * shift, atol=1e-3)
    assert found.misfit.argmax() == 1
    assert found.misfit[1] == pytest.approx(3 * 2 * 10.0**2, rel=0.1)


def test_advice_chooses_anchors_on_the_ground(towers):
    """Expected errors are those of the log with the fixes of the anchors chosen."""
    log, place = observe(towers[0], SensingParams(tilt_noise_deg=2.0, yaw_noise_deg=4.0)), towers[0]
    cues = cue_names()

    found = advise_together(log, cues, place.position, budget=2, kinds=("anchor",))

    assert {one.kind for one in found} == {"anchor"}
    standing = set(log.ground_docks[:, 0].tolist()) - {0}
    assert {one.robot for one in found} <= standing
    assert "anchor" not in {one.kind for one in advise(log, cues, place.position)}
    assert found[0].rmse_after < found[0].rmse_before
    first = found[0].robot
    fixes = [[first, *axis, place.position[first] @ axis, KNOWN_SD, -1.0] for axis in np.eye(3)]
    known = replace(log, fixes=np.array(fixes))
    [then] = advise_together(known, cues, place.position, budget=1, kinds=("anchor",))
    assert then.robot == found[1].robot
    assert then.rmse_before == pytest.approx(found[0].rmse_after, rel=1e-6)
    assert then.rmse_after == pytest.approx(found[1].rmse_after, rel=1e-6)


def test_robots_that_navigate_know_the_places_of_all_anchors(parted):
    """Anchors are one part, which has one frame; without them each founder has its own."""
    log = observe(parted, SensingParams())

    together, apart = _sides(parted, log), _sides(replace(parted, anchors=1), log)

    assert [part.robots.tolist() for part in together] == [[*range(24)]]
    assert len(apart) == 3


def test_a_run_reports_structures_with_several_anchors(tiswarm, tmp_path):
    """Through the command line: tables count anchors, and a second command asks for the next."""
    sets = ["robots=12", "seeds=1", "structure.anchors=2", "sensing.yaw_noise_deg=2.0"]
    options = [option for each in sets for option in ("--set", each)]

    done = tiswarm(
        "run", REPOSITORY / "tests/tower.yaml", *options, "--no-pictures", "--out", tmp_path
    )

    assert done.returncode == 0, done.stderr
    case = next(tmp_path.glob("tower-*/cases/*"))
    assert "anchors" in (case / "case.json").read_text()
    advised = tiswarm("advise", case / "sensing.jsonl", case / "estimate.csv", "--budget", 1,
                      "--kinds", "anchor")  # fmt: skip
    assert advised.returncode == 0, advised.stderr
    assert "as an anchor" in advised.stdout
    assert "together, 1 anchor: expected RMSE" in advised.stdout


def test_the_scenario_sweeps_anchors():
    """The shipped study has one, two and four of them on both kinds."""
    scenario = load_scenario(REPOSITORY / "scenarios" / "anchors.yaml")

    assert scenario.sweep["structure.anchors"] == (1, 2, 4)
