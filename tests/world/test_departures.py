"""Robots leave or die while a structure grows, and what is left stands by the rules."""

import dataclasses

import numpy as np
import pytest

from tests import frames, oracle, oracle_frames
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import uniform
from tiswarm.world.growth import grow
from tiswarm.world.history import DIED, FELL, LEFT, History
from tiswarm.world.history_file import find_fault, read_history, write_history
from tiswarm.world.mechanics import Frames, MechanicsParams
from tiswarm.world.params import (
    BridgeParams,
    CantileverParams,
    ChainParams,
    DepartureParams,
    GrowthParams,
    RecruitParams,
    TowerParams,
)
from tiswarm.world.walks import recruit, relay

FIREANT = RobotGeometry()
KINDS = {
    "tower": TowerParams(),
    "cantilever": CantileverParams(),
    "bridge": BridgeParams(gap=30.0),
    "chain": ChainParams(),
}


def _grown(params: GrowthParams, rate: float, kind: str = "leave", robots: int = 30, seeds=(0, 1)):
    """Structures of this kind in which robots leave or die."""
    departures = DepartureParams(rate=rate, kind=kind)
    params = dataclasses.replace(params, departures=departures)
    return grow(params, robots=robots, seeds=seeds, robot=FIREANT)


@pytest.fixture(scope="module")
def left() -> list[History]:
    """Two towers and two cantilevers of 30 robots, a fifth of which leave."""
    return _grown(KINDS["tower"], 0.2) + _grown(KINDS["cantilever"], 0.2)


def _docks(history: History) -> np.ndarray:
    """Where the docks of each robot are where it stayed [R], shape (N, 3, 3)."""
    turns = [oracle.matrix(q) for q in history.orientation_wxyz]
    return np.array(
        [c + FIREANT.dock_offset_body @ t.T for c, t in zip(history.position, turns, strict=True)]
    )


def _held(history: History, joined: int, gone: set[int]) -> set[int]:
    """Robots of the first that hang on the ground while others are gone, found one by one."""
    held: set[int] = set()
    standing = [walk.at_rest(np.r_[walk.ground_docks, walk.edge_docks]) for walk in history.walks]
    touched = [set(walk.at_rest(walk.contacts)[:, 1].tolist()) for walk in history.walks]
    while True:
        more = {
            j
            for j in set(range(joined)) - gone - held
            if len(standing[j]) or touched[j] & held or any(j in touched[k] for k in held)
        }
        if not more:
            return held
        held |= more


@pytest.mark.parametrize("movers", [1, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_left_is_sound(kind, movers):
    """Robots that remain touch where they say, do not overlap, and hang on the ground."""
    for history in _grown(dataclasses.replace(KINDS[kind], movers=movers), 0.2):
        assert find_fault(history, contact_gap=0.02) == ""
        gone = {robot for robot, _, event in history.departures.tolist() if event != DIED}
        rest = set(range(history.robot_count)) - gone
        assert gone
        assert _held(history, history.robot_count, gone) == rest
        docks, said = _docks(history), {tuple(row) for row in history.contacts.tolist()}
        for j in rest:
            for i in rest & set(range(j)):
                distance = np.linalg.norm(docks[i][:, None] - docks[j][None], axis=2)
                assert distance.min() > 2.0 - 1e-9
                pairs = np.argwhere(distance < 2.02).tolist()
                assert {(i, a, j, b) for a, b in pairs} <= said
        assert {robot for row in said for robot in row[::2]} <= rest


@pytest.mark.parametrize("movers", [1, 3])
def test_walks_meet_those_who_are_there(movers):
    """A walk touches no robot that left before it joined; some have a place that was taken."""
    taken = 0
    params = dataclasses.replace(KINDS["tower"], movers=movers)
    for history in _grown(params, 0.4, robots=40):
        docks, events = _docks(history), history.departures.tolist()
        for j, walk in enumerate(history.walks):
            before = {robot for robot, joined, _ in events if joined <= j}
            assert not set(walk.contacts[:, 2].tolist()) & before
            for i in before:
                distance = np.linalg.norm(docks[i][:, None] - docks[j][None], axis=2)
                taken += distance.min() < 1.9
    assert taken > 0


def test_who_leaves_is_drawn_by_seed_and_join(left):
    """One draw a join: whether one leaves, and who of those that are there and no founders."""
    for history in left:
        there, expected = set(), []
        for j in range(history.robot_count):
            there.add(j)
            chance, which = uniform(history.seed, "departure", j, np.arange(2))
            able = sorted(there - {0})
            if chance < 0.2 and able:
                there.remove(robot := able[int(which * len(able))])
                expected.append((robot, j + 1, LEFT))
                fallen = there - _held(history, j + 1, set(range(j + 1)) - there)
                expected += [(robot, j + 1, FELL) for robot in sorted(fallen)]
                there -= fallen
        assert [tuple(row) for row in history.departures.tolist()] == expected
    events = np.concatenate([history.departures for history in left])[:, 2]
    assert set(events.tolist()) == {LEFT, FELL}


def _same(a: History, b: History) -> bool:
    fields = [field.name for field in dataclasses.fields(a.walks[0])]
    return np.array_equal(a.departures, b.departures) and all(
        np.array_equal(getattr(x, name), getattr(y, name))
        for x, y in zip(a.walks, b.walks, strict=True)
        for name in fields
    )


def test_nobody_leaves_at_rate_0():
    """The structures are those that grow without the setting."""
    without = grow(KINDS["tower"], robots=20, seeds=[3], robot=FIREANT)[0]

    assert _same(_grown(KINDS["tower"], 0.0, robots=20, seeds=[3])[0], without)
    assert not len(without.departures)


@pytest.mark.parametrize("movers", [1, 3])
def test_company_changes_nobody(left, movers):
    """A seed loses the same robots alone and in a batch, by draws of its own."""
    params = dataclasses.replace(KINDS["tower"], movers=movers)
    batch = _grown(params, 0.3, seeds=(7, 3, 5))

    assert _same(_grown(params, 0.3, seeds=(3,))[0], batch[1])
    assert not np.array_equal(batch[0].departures, batch[1].departures)


def test_small_structures_are_how_great_ones_began():
    """What happens later changes nothing of what has happened before."""
    small, great = (_grown(KINDS["tower"], 0.3, robots=count)[0] for count in (12, 30))

    early = great.departures[great.departures[:, 1] <= 12]
    assert _same(small, dataclasses.replace(great, walks=great.walks[:12], departures=early))


@pytest.mark.parametrize("model", ["flexible", "rigid"])
@pytest.mark.parametrize("kind", ["leave", "die"])
def test_loads_are_those_of_the_robots_that_are_left(model, kind):
    """After each join, as a new frame of the remaining robots alone bears them."""
    params = dataclasses.replace(KINDS["cantilever"], mechanics=MechanicsParams(model=model))
    [history] = _grown(params, 0.3, kind, robots=25, seeds=[2])

    for joined in range(1, 26):
        expected = frames.solve(frames.grown(history, joined), model=model)
        load = history.loads[joined - 1]
        died = {r for r, after, e in history.departures.tolist() if e == DIED and after <= joined}
        living = [robot not in died for robot in frames.remaining(history, joined).tolist()]
        assert load.peak == pytest.approx(expected.peak, rel=1e-9)
        assert load.sensed_max == pytest.approx(expected.sensed[living].max(), rel=1e-9)
        assert load.imbalance < 1e-9
    mine = history.sensed[frames.remaining(history, 25)]
    np.testing.assert_allclose(mine, np.where(living, expected.sensed, np.nan), rtol=1e-9)
    assert np.isnan(history.sensed[history.departures[:, 0]]).all()


def test_a_frame_with_a_robot_taken_out_bears_what_a_frame_package_says(towers):
    """The frame of a tower, after one that many lean on is removed, against PyNite."""
    structure = frames.grown(towers[0], 20)
    built = Frames(MechanicsParams(), docks=3, robots=20)
    for j in range(20):
        frames.join(built, 0, structure, j)
    built.solve([0])
    robots = structure.contacts // 3
    spare = [j for j in range(1, 20) if len(_held(towers[0], 20, {j})) == 19]
    removed = max(spare, key=lambda j: np.count_nonzero(robots == j))

    built.remove(0, np.array([removed]))
    built.solve([0])

    event = np.array([(removed, 20, LEFT)], np.int32)
    rest = frames.grown(dataclasses.replace(towers[0], departures=event), 20)
    assert len(rest.contacts) < len(structure.contacts) - 1
    expected, actual = oracle_frames.beam_frame(rest, MechanicsParams()), built.loads(0)
    sensed = np.delete(actual.sensed, removed)
    np.testing.assert_allclose(sensed, expected.sensed, rtol=1e-9)
    assert np.isnan(actual.sensed[removed])
    stress = np.sort(actual.contact_stress)
    np.testing.assert_allclose(stress, np.sort(expected.contact_stress), rtol=1e-9)
    np.testing.assert_allclose(actual.ground_force.sum(axis=0), [0, 0, 57.0], atol=1e-8)


def test_robots_start_behind_those_that_are_left():
    """From spawn_min to spawn_max behind the rear-most dock, wherever those that left stood."""
    for history in _grown(KINDS["cantilever"], 0.4, seeds=range(3)):
        docks = _docks(history)
        for j, walk in enumerate(history.walks[1:], 1):
            standing = docks[frames.remaining(history, j)]
            rim = max(0.0, 1.0 - standing[:, :, 0].min())
            assert rim + 3.0 - 1e-9 <= -walk.center[0, 0] <= rim + 10.0 + 1e-9


def test_the_dead_call_nobody_and_pass_nothing_on():
    """Robots stay where they first touch a dock that carries a call past the living alone."""
    params, recruited, silenced = TowerParams(), 0, 0
    for history in _grown(params, 0.4, "die", robots=40):
        for j, walk in enumerate(history.walks[1:], 1):
            structure = frames.grown(history, j)
            dead = {robot for robot, joined, _ in history.departures.tolist() if joined <= j}
            mute = np.isin(np.arange(j), [*dead])
            sensed = frames.solve(structure).sensed
            call = recruit(np.where(mute, 0.0, sensed), params)
            carried = relay(call, structure.contacts, docks=3, mute=mute)
            touching = 3 * walk.contacts[:, 2] + walk.contacts[:, 3]
            stances = set(walk.contacts[carried[touching] > 0, 0].tolist())
            assert walk.recruited == bool(stances)
            assert stances <= {walk.stance_count - 1}
            recruited += walk.recruited
            spread = relay(recruit(sensed, params), structure.contacts, docks=3)
            silenced += np.count_nonzero(spread > carried)
        assert find_fault(history, contact_gap=0.02) == ""
        assert not history.is_gone.any()
    assert recruited > 5
    assert silenced > 50


def test_robots_that_leave_and_fall_end_no_call():
    """A structure that lost robots goes on to call by the loads of those that are left."""
    params = RecruitParams()
    for history in _grown(KINDS["tower"], 0.3):
        sensed = history.sensed[~np.isnan(history.sensed)]
        assert history.loads[-1].calling == np.count_nonzero(recruit(sensed, params))


def test_a_structure_that_lost_robots_is_read_back(left, tmp_path):
    """Its file has the departures; that of another structure is as it always was."""
    params = TowerParams(departures=DepartureParams(rate=0.2))
    write_history(left[0], tmp_path / "lost.npz")
    again = read_history(tmp_path / "lost.npz", params, FIREANT)

    assert again is not None
    assert _same(again, left[0])
    np.testing.assert_array_equal(again.sensed, left[0].sensed)
    whole = grow(TowerParams(), robots=4, seeds=[0], robot=FIREANT)[0]
    write_history(whole, tmp_path / "whole.npz")
    with np.load(tmp_path / "whole.npz") as arrays:
        assert "departures" not in arrays.files
    again = read_history(tmp_path / "whole.npz", TowerParams(), FIREANT)
    assert again is not None
    assert again.departures.shape == (0, 3)


def test_mechanics_are_solved_when_robots_leave_and_else_as_rarely_as_set():
    """Loads are known after the joins that robots left after, and after every fourth other one."""
    params = dataclasses.replace(KINDS["tower"], solve_every=4)
    [history] = _grown(params, 0.2, seeds=[1])
    events, since, expected = set(history.departures[:, 1].tolist()), 0, []

    for joined in range(1, 31):
        since += 1
        expected.append(since == 4 or joined in events or joined == 30)
        since = 0 if expected[-1] else since
    assert [not np.isnan(load.peak) for load in history.loads] == expected
