"""Structures grow by the rules, soundly, and the same way every time."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tests import frames, oracle
from tests.structures import grown
from tiswarm.base.robot import TANGENT_RHO, RobotGeometry
from tiswarm.compute.math import uniform
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.history_file import find_fault, from_arrays, to_arrays
from tiswarm.world.params import (
    BridgeParams,
    CantileverParams,
    ChainParams,
    ClimbParams,
    GrowthParams,
    TowerParams,
)
from tiswarm.world.walks import recruit, relay

FIREANT = RobotGeometry()


def _same(a: History, b: History) -> bool:
    return all(
        np.array_equal(getattr(x, field.name), getattr(y, field.name))
        for x, y in zip(a.walks, b.walks, strict=True)
        for field in dataclasses.fields(x)
    )


def test_towers_are_sound_and_touch_where_they_say(towers):
    """No overlap beyond 1e-9 R, and exactly the contacts that the final places imply."""
    for history in towers:
        docks = np.array(
            [
                center + FIREANT.dock_offset_body @ oracle.matrix(q).T
                for center, q in zip(history.position, history.orientation_wxyz, strict=True)
            ]
        )
        sensed = {tuple(row) for row in history.contacts}
        for j in range(history.robot_count):
            for i in range(j):
                distance = np.linalg.norm(docks[i][:, None] - docks[j][None], axis=2)
                assert distance.min() > 2.0 - 1e-9
                for a, b in np.argwhere(distance < 2.02):
                    assert (i, a, j, b) in sensed
                    sensed.discard((i, a, j, b))

        assert not sensed
        assert find_fault(history, contact_gap=0.02) == ""


def test_every_robot_but_the_first_touches_an_earlier_one(towers):
    """A robot that ends alone is spawned again."""
    for history in towers:
        assert set(history.contacts[:, 2]) == set(range(1, history.robot_count))
        assert history.spawns >= history.robot_count


def test_robots_stay_at_the_best_stance_of_their_walk(towers):
    """Who was not called for stays where it came nearest to the goal."""
    goal = np.array([0.0, 0.0, TowerParams().goal_height])
    for history in towers:
        for walk in history.walks:
            distance = np.linalg.norm(walk.center - goal, axis=1)

            assert walk.recruited or distance[-1] == distance.min()


def test_towers_climb():
    """Robots go up, and higher still where nobody calls them to the foot of the tower."""
    calls = grow(TowerParams(), robots=40, seeds=[5], robot=FIREANT)[0]
    silent = grow(TowerParams(recruit_limit=0), robots=40, seeds=[5], robot=FIREANT)[0]

    assert 15.0 < calls.position[:, 2].max() < silent.position[:, 2].max()


def test_company_does_not_change_a_structure():
    """A seed grows the same structure alone and in a batch."""
    alone = grow(TowerParams(), robots=12, seeds=[3], robot=FIREANT)[0]
    batch = grow(TowerParams(), robots=12, seeds=[1, 3, 2], robot=FIREANT)

    assert _same(alone, batch[1])
    assert not _same(batch[0], batch[2])


@pytest.mark.parametrize(("movers", "settings"), [(1, {}), (4, {"movers": 4})])
def test_each_walk_states_its_round(movers, settings):
    """One climber at a time ends its walk in each round; several join in fewer rounds."""
    [history] = grow(TowerParams(**settings), robots=24, seeds=[1], robot=FIREANT)

    rounds = [walk.round for walk in history.walks]

    assert rounds == sorted(rounds)
    if movers == 1:
        assert len(set(rounds)) == 24
        assert rounds[-1] + 1 == history.spawns
    else:
        assert max(Counter(rounds).values()) <= movers
        assert rounds[-1] + 1 < history.spawns


def test_a_structure_is_read_back_from_its_arrays():
    """Every field of the history and of each walk is the same again."""
    params = TowerParams(movers=2)
    [history] = grow(params, robots=9, seeds=[4], robot=FIREANT)

    again = from_arrays(to_arrays(history), params, FIREANT)

    assert _same(history, again)
    tables = {"sensed", "sent", "departures", "broken", "loaded_contacts", "contact_load"}
    tables |= {"departure_round"}
    compared_apart = {"walks", "loads"} | tables  # arrays, and NaN in them
    names = {field.name for field in dataclasses.fields(history)} - compared_apart
    assert {name: getattr(again, name) for name in names} == {
        name: getattr(history, name) for name in names
    }
    for name in tables:
        np.testing.assert_array_equal(getattr(again, name), getattr(history, name))
    loads = [[dataclasses.astuple(load) for load in each.loads] for each in (again, history)]
    np.testing.assert_array_equal(*loads)


def test_tangent_robots_grow_too():
    """With rho = 2 / sqrt(3) a robot's own docks touch, and growth still works."""
    robot = RobotGeometry(rho=TANGENT_RHO)

    history = grow(TowerParams(), robots=12, seeds=[0], robot=robot)[0]

    assert history.robot_count == 12
    assert find_fault(history, contact_gap=0.02) == ""


def test_growth_that_cannot_go_on_says_why_and_keeps_what_it_has():
    """Robots spawned far out with a short walk never arrive."""
    params = TowerParams(
        spawn_min=200.0, spawn_max=210.0, climb=ClimbParams(max_flips=3, max_spawns=4)
    )

    history = grow(params, robots=5, seeds=[0], robot=FIREANT)[0]

    assert history.robot_count == 1
    assert "max_spawns" in history.ended


def _moved(history: History, j: int, by: np.ndarray) -> History:
    walk = history.walks[j]
    moved = dataclasses.replace(walk, center=walk.center + by)
    return dataclasses.replace(history, walks=(*history.walks[:j], moved, *history.walks[j + 1 :]))


@pytest.mark.parametrize(
    ("by", "fault"),
    [
        ([0.0, 0.0, -50.0], "deep in the ground"),
        ([30.0, 0.0, 0.0], "in contact"),
        ([1e-3, 1e-3, 0.0], "overlap"),
    ],
)
def test_invalid_structures_are_found(towers, by, fault):
    """A robot pushed into the ground, torn off, or pressed into its neighbors."""
    faults = [
        find_fault(_moved(towers[0], j, sign * np.array(by)), contact_gap=0.02)
        for j in range(5, 30, 5)
        for sign in (1, -1)
    ]

    assert any(fault in found for found in faults)


def test_a_robot_held_by_nothing_is_found_out(towers):
    """A walk that ends without a contact cannot stay where it is."""
    walk = towers[0].walks[-1]
    loose = dataclasses.replace(
        walk, contacts=walk.contacts[:0], ground_docks=walk.ground_docks[:0]
    )
    history = dataclasses.replace(towers[0], walks=(*towers[0].walks[:-1], loose))

    assert "touches neither" in find_fault(history, contact_gap=0.02)


KINDS = {
    "tower": TowerParams(),
    "cantilever": CantileverParams(),
    "bridge": BridgeParams(gap=12.0),
    "chain": ChainParams(),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_grows_soundly(kind):
    """25 robots, or fewer where growth says why, hold together and do not overlap."""
    histories = grow(KINDS[kind], robots=25, seeds=[4, 5], robot=FIREANT)

    for history in histories:
        assert history.robot_count == 25 or history.ended
        assert find_fault(history, contact_gap=0.02) == ""
    assert any(history.robot_count == 25 or history.crossed for history in histories)


def _outward(kind: str, point: np.ndarray, start: np.ndarray) -> np.ndarray:
    """How far points lie behind the edge or from the axis [R], on the side of a robot's start."""
    if kind == "tower":
        return np.hypot(point[..., 0], point[..., 1])
    return point[..., 0] - 12.0 if start[0] > 6.0 else -point[..., 0]


@pytest.mark.parametrize("rule", ["rear", "placed", "leading"])
@pytest.mark.parametrize("kind", KINDS)
def test_robots_start_behind_the_dock_of_their_rule(kind, rule):
    """From spawn_min to spawn_max behind the rear-most or leading dock at that time."""
    params = dataclasses.replace(KINDS[kind], spawn_behind=rule)
    history = grow(params, robots=25, seeds=[4], robot=FIREANT)[0]
    turns = [oracle.matrix(q) for q in history.orientation_wxyz]
    arms = np.array([FIREANT.dock_offset_body @ turn.T for turn in turns])
    docks = history.position[:, None] + arms

    for j, walk in enumerate(history.walks):
        start, standing = walk.center[0], docks[rule == "placed" : j].reshape(-1, 3)
        behind = _outward(kind, standing, start).tolist() or [-1.0]
        rim = max(0.0, 1.0 + (min(behind) if rule == "leading" else max(behind)))
        assert rim + 3.0 - 1e-9 <= _outward(kind, start, start) <= rim + 10.0 + 1e-9


def test_structures_at_an_edge_go_where_they_should(cantilevers, bridges, chains):
    """Out over the edge, across the gap, down from the edge."""
    for history in cantilevers:
        assert history.position[:, 0].max() > 5.0
    for history in bridges:
        assert history.position[:, 0].min() < 1.0
        assert history.position[:, 0].max() > history.terrain.right_edge - 3.0
    for history in chains:
        assert history.position[:, 2].min() < -10.0


def _calling(history: History, count: int, params: GrowthParams) -> set[tuple[int, int]]:
    """Docks that recruit a robot that touches them while `count` robots stand, (robot, dock)."""
    if count == 0:
        return set()
    structure = frames.grown(history, count)
    call = recruit(frames.solve(structure).sensed, params)
    docks = np.flatnonzero(relay(call, structure.contacts, docks=3) > 0)
    return {divmod(int(dock), 3) for dock in docks}


@pytest.mark.parametrize("kind", ["towers", "cantilevers", "bridges", "chains"])
def test_robots_are_recruited_where_they_first_touch_a_calling_dock(kind, request):
    """Nobody walks on from a dock that calls, and nobody stops for one that does not."""
    recruited = 0
    for history in request.getfixturevalue(kind):
        for j, walk in enumerate(history.walks):
            calling = _calling(history, j, TowerParams())
            stances = [s for s, _, i, k in walk.contacts if (int(i), int(k)) in calling]

            assert walk.recruited == bool(stances)
            assert set(stances) <= {walk.stance_count - 1}
            recruited += walk.recruited
    assert recruited > 5 or kind == "chains"


def _held_together(history: History, count: int) -> bool:
    """Whether robots on both sides of a gap hang together, by the first `count` robots."""
    i, _, j, _ = history.contacts[history.contacts[:, 2] < count].T
    links = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    part = connected_components(links, directed=False)[1]
    standing = np.concatenate([history.ground_docks, history.edge_docks])
    robot = standing[standing[:, 0] < count, 0]
    right = np.array(
        [_on_the_right(history, r, k) for r, k in standing if r < count],
        dtype=bool,
    )
    return bool(set(part[robot[right]]) & set(part[robot[~right]]))


def _on_the_right(history: History, robot: int, dock: int) -> bool:
    turn = oracle.matrix(history.orientation_wxyz[robot])
    place = history.position[robot] + turn @ FIREANT.dock_offset_body[dock]
    return bool(place[0] > 0.5 * history.terrain.right_edge)


def test_a_bridge_is_complete_with_the_robot_that_joins_its_sides(bridges):
    """Growth ends then, says so, and not a robot earlier."""
    for history in bridges:
        count = history.robot_count

        assert history.crossed
        assert history.ended == f"the gap is bridged by {count} robots"
        assert _held_together(history, count)
        assert not _held_together(history, count - 1)


def test_a_bridge_that_runs_out_of_robots_is_not_crossed():
    """Two robots do not reach across 20 R, and nothing else ended growth."""
    history = grow(BridgeParams(), robots=2, seeds=[0], robot=FIREANT)[0]

    assert not history.crossed
    assert history.ended == ""
    assert history.position[0, 0] < 10.0 < history.position[1, 0]


@pytest.mark.parametrize("kind", KINDS)
def test_small_structures_are_how_great_ones_began(kind):
    """Robots one at a time: what joins later changes nothing of what has joined before."""
    small, great = (
        grow(KINDS[kind], robots=robots, seeds=[4], robot=FIREANT)[0] for robots in (6, 12)
    )

    assert small.robot_count == 6
    first = dataclasses.replace(great, walks=great.walks[:6])
    assert _same(small, first)


def test_one_mover_is_what_robots_one_at_a_time_are():
    """The default, spelled out."""
    one, default = (
        grow(params, robots=12, seeds=[2], robot=FIREANT)[0]
        for params in (TowerParams(movers=1), TowerParams())
    )

    assert _same(one, default)


def test_more_movers_than_robots_take_no_memory():
    """The slots of the others would stay empty, and a billion of them fill any memory."""
    many, few = (grown(TowerParams(movers=movers), robots=5, seed=0) for movers in (10**9, 5))

    assert _same(many, few)


@pytest.mark.parametrize("kind", ["tower", "cantilever"])
def test_several_movers_grow_one_sound_structure(kind):
    """Three at a time: none joins into another, and they join elsewhere than one at a time."""
    params = dataclasses.replace(KINDS[kind], movers=3)

    grown = grow(params, robots=25, seeds=[0, 1], robot=FIREANT)
    alone = grow(KINDS[kind], robots=25, seeds=[0, 1], robot=FIREANT)

    for history in grown:
        assert history.robot_count == 25
        assert find_fault(history, contact_gap=0.02) == ""
    assert not _same(alone[0], grown[0])


def _settling(share: float, robots: int = 40) -> History:
    """A tower in which this share of the robots settle."""
    params = TowerParams(climb=ClimbParams(settle=share))
    return grow(params, robots=robots, seeds=[7], robot=FIREANT)[0]


def test_settled_robots_touch_with_all_docks():
    """Robots that turn about two docks until the third touches gain a contact, and stay sound."""

    def touching(history):
        docks = [
            {own for own, *_ in walk.at_rest(walk.contacts)} | set(_grounded(walk))
            for walk in history.walks
        ]
        return np.mean([len(own) == 3 for own in docks])

    none, half, every = (_settling(share) for share in (0.0, 0.5, 1.0))

    assert touching(none) < 0.3 < touching(half) < 0.8 < touching(every)
    assert find_fault(half, contact_gap=0.02) == find_fault(every, contact_gap=0.02) == ""


def test_a_greater_share_settles_more_robots_and_the_same_ones():
    """Half of the robots settle, by a draw for each; up to the first that differs, all is alike."""
    none, half, every = (_settling(share, 20) for share in (0.0, 0.5, 1.0))

    def first_difference(a, b):
        pairs = zip(a.walks, b.walks, strict=True)
        return next(j for j, (x, y) in enumerate(pairs) if len(x.center) != len(y.center))

    drawn = uniform(7, "settle", np.arange(20), 0) < 0.5
    settled = [w.stance_count for w in every.walks] != [w.stance_count for w in none.walks]
    assert settled
    assert drawn[first_difference(half, none)]
    assert not drawn[first_difference(half, every)]


def _grounded(walk):
    return walk.at_rest(walk.ground_docks)[:, 0]


@pytest.mark.parametrize("kind", KINDS)
def test_an_anchor_that_is_put_stays_there(kind):
    """It does not climb; the log, and with it every estimate, has it at that place."""
    climb = dataclasses.replace(KINDS[kind].climb, settle=1.0)
    params = dataclasses.replace(KINDS[kind], anchor=3.5, founders=2, climb=climb)

    for history in grow(params, robots=8, seeds=[4, 5], robot=FIREANT):
        assert history.walks[0].stance_count == 1
        assert observe(history, SensingParams()).anchor_position.tolist() == [-3.5, 0.0, 1.0]
        assert find_fault(history, contact_gap=0.02) == ""
        assert history.robot_count == 8


def test_an_anchor_at_the_very_edge_does_not_move():
    """Not even where one of its docks is over the edge and others settle."""
    params = CantileverParams(anchor=0.0, climb=ClimbParams(settle=1.0))

    history = grow(params, robots=3, seeds=[0], robot=FIREANT)[0]

    assert np.array_equal(history.walks[0].center, [[0.0, 0.0, 1.0]])


@pytest.mark.parametrize(("kind", "sides"), [("cantilever", 1), ("bridge", 2)])
@pytest.mark.parametrize("founders", [1, 2])
def test_only_founders_stay_alone(kind, sides, founders):
    """The first robots of each side may stay without a neighbor, and some do."""
    params = dataclasses.replace(KINDS[kind], anchor=9.0, founders=founders, spawn_behind="placed")
    alone = set()
    for history in grow(params, robots=12, seeds=range(8), robot=FIREANT):
        touching = set(history.contacts[:, 2].tolist())
        alone |= set(range(history.robot_count)) - touching

    assert alone == set(range(founders * sides))
