"""Kernels of joint: forces against energies written out slowly, heat, rows, and threads."""

import dataclasses

import numpy as np
import pytest

from tests import oracle
from tests.structures import NOISY, silent, with_directions, with_fixes, with_ranges
from tiswarm.localization.chains.annealer import anneal, annealer_of
from tiswarm.localization.chains.arrays import BlockProgress, BodyMotion, Heading, SubtreeMotion
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import ANNEALING, find_subtrees, reinitialize_lost, weights
from tiswarm.localization.joint import localize_batch
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe

SHORT = JointParams(chains=2, steps=300, hold_steps=100)
PAIR = JointParams(steps=300, start_sigma=0.1, end_sigma=0.1, cues=Cues(non_overlap=False))
BIASED = dataclasses.replace(NOISY, yaw_bias_deg=15.0, spawn_noise=0.2)


@pytest.fixture(scope="module")
def log(tall_towers) -> SensingLog:
    """What the robots of a small tower sensed, with noise."""
    return observe(tall_towers[0], NOISY)


@pytest.mark.parametrize("steps", [4, 40])
@pytest.mark.parametrize("robust", [True, False])
@pytest.mark.parametrize("noise", [NOISY, BIASED])
@pytest.mark.parametrize("docks", ["both", "directed", "own", "none"])
def test_forces_match_the_energies_written_out_slowly(tall_towers, docks, noise, robust, steps):
    """Contacts, overlaps and known places pull and turn as sums over all of them say.

    Docks grow in the first tenth of the steps. Every third robot has four fixes, and robots
    measure how far others are. Every other robot may measure the directions of its contacts; or
    no robot knows their docks.
    """
    if docks in {"own", "none"}:
        noise = dataclasses.replace(noise, contact_docks=docks)
    log = with_fixes(
        observe(tall_towers[0], noise), tall_towers[0], range(3, 30, 3), each=4, sd=0.2
    )
    log = with_ranges(log, tall_towers[0], reach=5.0, sd=0.1)
    if docks == "directed":
        log = with_directions(log, tall_towers[0], sd_deg=5.0, robots=range(0, 30, 2))
    params = dataclasses.replace(SHORT, robust=robust, start_sigma=0.3, end_sigma=0.3)
    known = pose_problem(log, params)
    annealer = annealer_of([log], [params], [known])
    annealer.advance(steps)
    before, heading = (
        annealer.by_robot(annealer.swarm.position),
        annealer.by_robot(annealer.swarm.heading),
    )
    yaw = heading[:, :, Heading.YAW]
    size = 2.0 * min(1.0, (steps + 1) / (ANNEALING.growing * SHORT.steps))

    annealer.advance(steps + 1)

    forces = annealer.by_robot(annealer.swarm.motion)[..., : BodyMotion.MASS]
    torques = annealer.by_robot(annealer.swarm.heading)[:, :, Heading.TORQUE]
    is_biased = noise.yaw_bias_deg > 0.0
    assert (np.abs(yaw).max() > 0.05) == is_biased
    for k in range(SHORT.chains):
        width = 3.0 if robust else np.inf
        slow = oracle.joint_force(
            log, known, before[k], yaw[k], 0.3, width, params.extension_prior, size
        )
        np.testing.assert_allclose(forces[k, 1:], slow[0][1:], rtol=1e-9, atol=1e-11)
        if is_biased:
            np.testing.assert_allclose(torques[k], slow[1], rtol=1e-9, atol=1e-10)


def test_a_robot_that_lost_touch_is_put_back(tall_towers):
    """And nobody else, in no other chain, along no axis that is known."""
    history = tall_towers[0]
    known = pose_problem(observe(history, SensingParams()), JointParams())
    position = np.tile(history.position, (2, 1, 1))
    position[1, -1] += [25.0, 10.0, 1.5]

    moved = reinitialize_lost(known, position, np.zeros(position.shape[:2]))

    assert moved == 1
    assert np.linalg.norm(position[1, -1, :2] - history.position[-1, :2]) < 2.0
    assert position[1, -1, 2] == history.position[-1, 2] + 1.5
    np.testing.assert_array_equal(position[:, :-1], np.tile(history.position[:-1], (2, 1, 1)))
    np.testing.assert_array_equal(position[0], history.position)


def test_a_robot_that_noise_alone_moved_is_not_put_back(tall_towers):
    """Where equations are as uncertain as that, nobody is lost."""
    history = tall_towers[0]
    known = pose_problem(observe(history, SensingParams()), JointParams())
    position = history.position[None].copy()
    position[0, -1] += [25.0, 10.0, 1.5]
    unsure = dataclasses.replace(known, variance=known.variance + 10.0**2)

    assert reinitialize_lost(unsure, position, np.zeros(position.shape[:2])) == 0


def test_anchors_stay_where_they_are(tall_towers):
    """Whatever is shifted or turned."""
    log = observe(tall_towers[0], BIASED)

    found = anneal([log], [SHORT], [pose_problem(log, SHORT)])[0]

    for positions in (found.mean, found.last, found.trace):
        np.testing.assert_allclose(positions[:, 0] - log.anchor_position, 0.0, atol=1e-12)


@pytest.mark.parametrize(("spawn_noise", "fixed"), [(None, []), (0.2, []), (None, [9, 17])])
def test_a_robot_goes_with_every_branch_that_it_is_of(tall_towers, spawn_noise, fixed):
    """What pulls at a branch pulls at its robots; where robots of it are known, it is not shifted.

    All robots know their heights, and some where they started, or their x.
    """
    log = observe(tall_towers[0], dataclasses.replace(NOISY, spawn_noise=spawn_noise))
    at = tall_towers[0].position[fixed]
    fixes = [[i, 1.0, 0.0, 0.0, x, 0.1, -1.0] for i, x in zip(fixed, at[:, 0], strict=True)]
    log = dataclasses.replace(log, fixes=np.array(fixes).reshape(-1, 7))
    params = dataclasses.replace(SHORT, cues=Cues(walk_contacts=False))
    known = pose_problem(log, params)
    annealer = annealer_of([log], [params], [known])
    tree = find_subtrees(known.pair, known.roots, log.robot_count)
    count = len(tree.parent)
    annealer.advance(4)
    before = annealer.by_robot(annealer.swarm.position)
    _, mass, speed = _split(annealer.by_robot(annealer.swarm.motion))
    slow = speed * np.sqrt(mass)
    _, weight, speed = _split(
        annealer.trees.motion.to_numpy().reshape(-1, count, SubtreeMotion.WEIGHT + 1)
    )
    heavy_before = speed * np.sqrt(weight)

    annealer.advance(5)

    # Robots and branches that become heavier keep their kinetic energy.
    force, mass, speed = _split(annealer.by_robot(annealer.swarm.motion))
    expected = 0.5 * (slow / np.sqrt(mass) + force / mass + speed)
    pulls, weight, heavy = _split(
        annealer.trees.motion.to_numpy().reshape(-1, count, SubtreeMotion.WEIGHT + 1)
    )
    for k in range(1, count):
        robots = _members(tree, k)
        own = tree.order[tree.first[k] : tree.first[k + 1]]
        np.testing.assert_allclose(pulls[:, k], force[:, robots].sum(axis=1), atol=1e-12)
        np.testing.assert_allclose(
            weight[:, k], weights(tree)[k] * mass[:, own].sum(axis=1), rtol=1e-12
        )
        kept = heavy_before[:, k] / np.sqrt(weight[:, k])
        shift = 0.5 * (kept + pulls[:, k] / weight[:, k] + heavy[:, k])
        is_free = np.array([not set(fixed) & set(robots.tolist()), True, False])
        expected[:, robots] += shift[:, None] * (is_free & (spawn_noise is None))
    np.testing.assert_allclose(
        (annealer.by_robot(annealer.swarm.position) - before)[:, 1:], expected[:, 1:], atol=1e-12
    )


def _split(motion):
    """Split a table of motions into forces, masses and velocities."""
    return (
        motion[..., : BodyMotion.MASS],
        motion[..., BodyMotion.MASS : BodyMotion.VELOCITY],
        motion[..., BodyMotion.VELOCITY : BodyMotion.VELOCITY + 3],
    )


def test_a_pair_stands_as_far_apart_as_its_likelihood_says():
    """Alone, a robot that touches another is that much likelier the farther their centers are.

    The contact leaves open a direction, u on a sphere around the dock it touches; all are as likely
    but for `stretch`.
    """
    log = _pair()
    cosine = np.linspace(-1.0, 1.0, 2001)  # of u with the x axis, along which both docks lie
    far = np.sqrt(9.0 + 4.0 + 12.0 * cosine)
    for stretch in (0.0, 1.0):
        params = dataclasses.replace(
            PAIR, chains=200, hold_steps=2000, extension_prior=stretch, robust=False
        )
        found = anneal([log], [params], [pose_problem(log, params)])[0]
        weight = np.exp(stretch * far)
        expected = 3.0 + 2.0 * np.sum(cosine * weight) / weight.sum()
        assert found.mean[:, 1, 0].mean() == pytest.approx(expected, abs=0.1)


def test_what_is_likelier_the_farther_it_reaches_does_not_draw_contacts_out():
    """However little is known of them: docks stay as near each other as without `stretch`."""
    log = _pair()
    length = []
    for stretch in (0.0, 1.0):
        params = dataclasses.replace(
            PAIR, chains=1000, hold_steps=1, extension_prior=stretch, contact_sd=1.0, robust=False
        )
        known = pose_problem(log, params)
        found = anneal([log], [params], [known])[0]
        length.append(known.residual(found.last, found.last_yaw).mean())
    assert length[1] == pytest.approx(length[0], abs=0.1)


def _pair() -> SensingLog:
    """Two robots of one dock each, which touch; orientation is all else that is known."""
    return silent(
        np.zeros((2, 3)),
        dock_offset_body=np.array([[1.5, 0.0, 0.0]]),
        orientation_wxyz=np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
        contacts=[[0, 0, 1, 0]],
    )


@pytest.mark.parametrize("noise", [SensingParams(), BIASED])
def test_every_contact_has_its_share_of_the_heat(tall_towers, noise):
    """Equipartition: kicks and steps keep the energy of what is independent at s^2 / 2 each.

    Where steps were too long for what swings they would pump energy in.
    """
    log = observe(tall_towers[0], dataclasses.replace(noise, spawn_noise=None))
    tolerance = dict.fromkeys(["start_sigma", "end_sigma"], 0.1)
    cues = Cues(walk_contacts=False, height=False, ground=False, non_overlap=False)
    params = JointParams(
        chains=64, steps=1000, hold_steps=1, extension_prior=0.0, cues=cues, robust=False,
        **tolerance,
    )  # fmt: skip
    known = pose_problem(log, params)

    found = anneal([log], [params], [known])[0]

    gap = known.residual(found.last, found.last_yaw)
    assert np.mean(gap**2 / (known.variance + 0.1**2)) == pytest.approx(1.0, abs=0.1)


def _members(tree, branch):
    """Robots of a branch: its own and all of those that grow out of it."""
    grown = [k for k in range(1, len(tree.parent)) if tree.parent[k] == branch]
    own = tree.order[tree.first[branch] : tree.first[branch + 1]]
    return np.concatenate([own, *(_members(tree, k) for k in grown)])


def test_steps_are_the_same_however_threads_share_them(tall_towers):
    """A thread for each structure, or all for each step: the same bits, lists of any length.

    Structures that cool unlike each other too.
    """
    logs = [observe(h, n) for h, n in zip(tall_towers, [NOISY, BIASED, BIASED], strict=True)]
    short = dataclasses.replace(SHORT, steps=60, hold_steps=20)
    params = [dataclasses.replace(short, end_sigma=end) for end in (None, 0.1, 0.2)]
    known = [pose_problem(log, p) for log, p in zip(logs, params, strict=True)]
    swarms = [annealer_of(logs, params, known, by_block=by_block) for by_block in (True, False)]
    rows = swarms[0].neighbors
    rows.make_room(0)  # what does not fit is given room on the way

    runs = [annealer.run() for annealer in swarms]

    assert rows.capacity > 2
    for a, b in zip(*runs, strict=True):
        assert a.trace.tobytes() == b.trace.tobytes()
        assert a.mean.tobytes() == b.mean.tobytes()
        assert a.mean_yaw.tobytes() == b.mean_yaw.tobytes()
        assert a.within.tobytes() == b.within.tobytes()


@pytest.mark.parametrize("robots", [40, 300])
def test_a_pair_of_overlapping_robots_is_found_once_or_twice_with_the_same_bits(robots):
    """One thread sums each pair once, from lists in the order of numbers, or sorted by cells.

    All threads sum it at both robots, from rows that list all others.
    """
    place = np.random.default_rng(7).uniform(0.0, 2.5 * robots ** (1.0 / 3.0), (robots, 3))
    log, params = silent(place), JointParams(chains=2, steps=30, hold_steps=5)
    swarms = [
        annealer_of(
            [log],
            [params],
            [pose_problem(log, params)],
            start=[place + np.zeros((2, 1, 1))],
            by_block=by_block,
        )
        for by_block in (True, False)
    ]

    one, all_threads = (annealer.run()[0] for annealer in swarms)

    assert np.linalg.norm(one.last - place, axis=2).max() > 0.1
    assert one.last.tobytes() == all_threads.last.tobytes()
    entries = [a.memory.download(a.neighbors.rows.count).sum() for a in swarms]
    assert entries[0] < entries[1]


def test_rows_serve_as_if_made_anew_for_each_step(log):
    """Thin ones while all is hot, thick ones for many steps later: no overlap is missed."""
    known = [pose_problem(log, SHORT)]
    kept, anew = (annealer_of([log], [SHORT], known) for _ in range(2))
    skins, ages = set(), []

    for step in range(1, SHORT.steps + 1):
        kept.advance(step)
        progress = kept.blocks.progress.to_numpy()
        skins |= set(progress[:, BlockProgress.IS_THIN].tolist())
        ages.append(progress[:, BlockProgress.AGE].max())
        anew.forget_rows()
        anew.advance(step)

    assert skins == {0, 1}
    assert max(ages) > 5
    assert kept.swarm.position.to_numpy().tobytes() == anew.swarm.position.to_numpy().tobytes()


def test_the_share_of_the_steps_that_is_done_grows_up_to_all_of_them(log):
    """From none to one, in even parts, with the steps at the end temperature."""
    shares = []

    anneal([log], [SHORT], [pose_problem(log, SHORT)], on_progress=shares.append)

    even = np.union1d(np.linspace(0.0, 1.0, ANNEALING.frames), [0.75])
    np.testing.assert_allclose(shares, even, atol=1.0 / 400)


def test_progress_moves_with_each_structure_that_is_searched(tall_towers):
    """Annealings are half of the work; the other half is a search, structure by structure."""
    shares = []

    localize_batch([observe(each, NOISY) for each in tall_towers], [SHORT] * 3, shares.append)

    assert shares == sorted(shares)
    np.testing.assert_allclose(shares[-4:], [1 / 2, 2 / 3, 5 / 6, 1])
