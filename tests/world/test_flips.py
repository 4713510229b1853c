"""A flip stops where a dock first touches something, and nowhere else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracle
from tests.strategies import unit_vectors, vectors
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.lang import F64, Reals2, Reals3, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.records.terrain import Terrain
from tiswarm.world.climb_kernels import (
    ClimbLimits,
    Obstacles,
    Site,
    crossing_angles,
    first_met,
    turn_about,
)
from tiswarm.world.growth import grow
from tiswarm.world.params import ClimbParams, TowerParams
from tiswarm.world.walks import climb_limits

FULL_TURN = 2.0 * np.pi


@ti.kernel
def _crossing_angles(level: Reals2, angles: Reals2):
    for i in range(level.shape[0]):
        both = crossing_angles(level[i, 0], level[i, 1], level[i, 2], FULL_TURN)
        angles[i, 0] = both[0]
        angles[i, 1] = both[1]


def _meeting(arm, axis, obstacle, spacing=2.0):
    """Forward and backward angle at which a dock at `arm` meets one at `obstacle`."""
    along = arm @ axis
    level = 0.5 * (arm @ arm + obstacle @ obstacle - spacing**2) - along * (obstacle @ axis)
    query = np.array([[obstacle @ (arm - along * axis), obstacle @ np.cross(axis, arm), level]])
    angles = np.zeros((1, 2))
    _crossing_angles(query, angles)
    return angles[0]


@settings(max_examples=200)
@given(arm=vectors, axis=unit_vectors, obstacle=vectors)
def test_contact_angle_is_where_a_fine_sweep_first_overlaps(arm, axis, obstacle):
    """The closed form agrees with turning the dock step by step, both ways."""
    if np.linalg.norm(arm - obstacle) < 2.05:
        return  # docks never overlap; touching at the start is another test's matter

    forward, backward = _meeting(arm, axis, obstacle)

    for angle, sign in ((forward, 1.0), (backward, -1.0)):
        swept = oracle.first_meeting(arm, sign * axis, obstacle, 2.0)
        if abs(oracle.closest_approach(arm, axis, obstacle) - 2.0) < 1e-3:
            continue  # a graze that a sweep in steps may miss
        if np.isinf(swept):
            assert angle == FULL_TURN
        else:
            end = oracle.turned(arm, axis, sign * angle)
            assert swept == pytest.approx(angle, abs=2.5 * FULL_TURN / oracle.FINE)
            assert np.linalg.norm(end - obstacle) == pytest.approx(2.0, abs=1e-9)


@ti.kernel
def _first_met(
    limits: ClimbLimits, body: Reals2, axis: Reals2, gains: Reals2, least: F64, near: Reals3,
    angles: Reals2,
):  # fmt: skip
    obstacles = ti.static(Obstacles(near, Site(None, is_flat=True, has_zones=False)))
    for way in range(1):
        aim = ti.Vector([gains[0, 0], gains[0, 1], least, limits.min_flip])
        pivot = ti.Vector([0.0, 0.0, 100.0])
        unturned = ti.Vector([1.0, 0.0, 0.0, 0.0])
        turn = turn_about(vector_at(axis, 0), 0, unturned, pivot)
        first = first_met(limits, body, turn, obstacles, way, near.shape[1], aim)
        angles[0, 0], angles[0, 1] = first[0], first[1]


@settings(max_examples=300)
@given(
    seed=st.integers(0, 2**32),
    count=st.integers(1, 20),
    least=st.floats(-1.0, 1.0) | st.just(-np.inf),
    grazes=st.booleans(),
    rests=st.booleans(),
    second=st.booleans(),
)
def test_angles_of_flips_that_gain_enough_are_those_of_all_obstacles(
    seed, count, least, grazes, rests, second
):
    """To compute few of the angles changes none of those that count, with one free dock and two.

    Also where docks graze or rest on others, and where two are met at once. Compilers may round
    the two kernels differently, which a grazing contact magnifies.
    """
    rng = np.random.default_rng(seed)
    arm = np.array([2.6, 0.0, 0.0])
    axis = np.array([0.0, *rng.normal(size=2)])
    axis /= np.linalg.norm(axis)
    arms = [arm, 2.6 * oracle.turned(arm / 2.6, axis, 0.8)] if second else [arm]
    place = rng.normal(size=(40, 3))
    place *= rng.uniform(2.0, 4.6, (40, 1)) / np.linalg.norm(place, axis=1)[:, None]
    if grazes:  # as near to the dock's circle as just touches it, or just does not
        turn, lean = rng.uniform(0.0, 2.0 * np.pi, (2, 40))
        near = 2.0 + 1e-9 * rng.choice([-1.0, 1.0], (40, 1))
        out = np.cos(turn)[:, None] * arm / 2.6 + np.sin(turn)[:, None] * np.cross(axis, arm) / 2.6
        place[::3] = (
            2.6 * out + near * (np.cos(lean)[:, None] * out + np.sin(lean)[:, None] * axis)
        )[::3]
    if rests:
        place[1] = arm + 2.0 * place[1] / np.linalg.norm(place[1])
    place[4] = place[2]
    distances = np.linalg.norm(place[:, None] - np.array(arms), axis=2)
    place = place[(distances > 2.0 - 1e-12).all(axis=1)][:count]
    body = np.array([np.zeros(3), *arms])
    gains, angles = rng.normal(size=(1, 2)), np.zeros((1, 2))
    limits = climb_limits(ClimbParams(), RobotGeometry(), Terrain(), by_belief=False)

    _first_met(limits, body, axis[None], gains, least, place[None], angles)

    met = np.array([FULL_TURN, FULL_TURN])
    for turning in arms:
        for obstacle in place:
            met = np.minimum(met, _meeting(turning, axis, obstacle))
    gain = np.cos(met) * gains[0, 0] + np.array([1.0, -1.0]) * np.sin(met) * gains[0, 1]
    counts = (met >= limits.min_flip) & (gain >= least)
    is_same = np.isclose(angles[0], met, rtol=0.0, atol=1e-9)
    assert is_same[counts].all()
    assert (is_same | (angles[0] == 0.0)).all()


@given(axis=unit_vectors, towards=st.booleans())
def test_a_dock_that_rests_on_another_cannot_turn_into_it(axis, towards):
    """Touching at the start blocks the turn inward at once, and leaves the other way free."""
    arm = 2.6 * np.cross(axis, np.roll(axis, 1) + 0.1)
    if np.linalg.norm(arm) < 0.5:
        return
    onward = np.cross(axis, arm) / np.linalg.norm(np.cross(axis, arm))
    obstacle = arm + (2.0 if towards else -2.0) * onward

    forward, backward = _meeting(arm, axis, obstacle)

    assert (forward if towards else backward) == pytest.approx(0.0, abs=1e-6)
    assert (backward if towards else forward) > 0.05


@pytest.mark.parametrize("half_side", np.linspace(1.05, 1.35, 31))
def test_a_dock_that_may_not_turn_either_way_stays(half_side):
    """Two docks rest on one beyond the axis, all in a plane: any turn brings the second nearer."""
    corner = np.deg2rad(45.0)
    arm = 2.0 * half_side * np.array([np.sin(corner), np.cos(corner), 0.0])
    beyond = corner - np.arccos(half_side / 2.0)
    obstacle = 2.0 * np.array([np.sin(beyond), np.cos(beyond), 0.0])

    angles = _meeting(arm, np.array([0.0, 1.0, 0.0]), obstacle)

    assert beyond < 0.0
    assert np.linalg.norm(arm - obstacle) == pytest.approx(2.0, abs=1e-12)
    np.testing.assert_allclose(angles, 0.0, atol=1e-6)


def test_walks_keep_their_pivot_where_it_is(towers):
    """From stance to stance the dock that the robot turns about does not move."""
    _assert_pivots_stay(towers)


def test_walks_that_go_on_after_settling_keep_their_pivot():
    """Robots that settle go on from where they came, if others join beside them meanwhile."""
    params = TowerParams(movers=4, climb=ClimbParams(settle=1.0))
    # Robot 61 of this seed settles away from the end of its walk, beside one that joins first.
    _assert_pivots_stay(grow(params, robots=62, seeds=[14], robot=RobotGeometry()))


def _assert_pivots_stay(histories):
    for history in histories:
        body = history.robot.dock_offset_body
        for walk in history.walks:
            dock = [
                center + oracle.matrix(q) @ body.T[:, k]
                for center, q, k in zip(
                    walk.center, walk.orientation_wxyz, [*walk.pivot_dock, 0], strict=True
                )
            ]
            for step, k in enumerate(walk.pivot_dock):
                after = (
                    walk.center[step + 1] + oracle.matrix(walk.orientation_wxyz[step + 1]) @ body[k]
                )
                np.testing.assert_allclose(after, dock[step], atol=1e-12)


def test_no_dock_passes_through_another_on_the_way(towers):
    """One of the two ways round each flip of the last robots, sampled finely, is free."""
    history = towers[0]
    body = history.robot.dock_offset_body
    for j in range(history.robot_count - 5, history.robot_count):
        walk = history.walks[j]
        others = np.concatenate([_docks(history, i) for i in range(j)])
        for step, k in enumerate(walk.pivot_dock):
            paths = oracle.flip_paths(walk, step, body, k)

            assert max(_clearance(docks, others) for docks in paths) > -1e-9


def test_every_pivot_holds_on_to_something(towers):
    """A robot flips about docks that touch another robot or the ground."""
    for history in towers:
        for walk in history.walks:
            touched = {(s, k) for s, k, _, _ in walk.contacts} | set(map(tuple, walk.ground_docks))

            assert all((s, k) in touched for s, k in enumerate(walk.pivot_dock))


def _docks(history, i):
    turn = oracle.matrix(history.orientation_wxyz[i])
    return history.position[i] + history.robot.dock_offset_body @ turn.T


def _clearance(docks, others):
    """Least gap to the structure and the ground along a path of docks, (steps, 3, 3)."""
    gap = np.linalg.norm(docks[:, :, None] - others, axis=3).min() - 2.0
    return min(gap, docks[..., 2].min() - 1.0)
