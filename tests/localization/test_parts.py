"""Parts of a swarm that no contact ties to the anchor, and the planes that hold them."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import oracle
from tests.structures import Rule, structure, with_heights
from tiswarm.localization.chains.annealer import annealer_of
from tiswarm.localization.chains.arrays import BodyMotion, SubtreeLabel
from tiswarm.localization.chains.problem import Planes, pose_problem
from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.observability import observability

SHORT = JointParams(chains=2, steps=40, hold_steps=20, start_sigma=0.3, end_sigma=0.3)
ROBOTS = 6
PART = np.array([0, 0, 1, 1, 2, 2], np.int32)
DIRECTIONS = [*np.eye(3), [0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [2 / 3, 1 / 3, 2 / 3]]
PLANES = st.lists(
    st.tuples(
        st.integers(1, ROBOTS - 1),
        st.integers(0, len(DIRECTIONS) - 1),
        st.floats(-9.0, 9.0),
        st.floats(0.1, 9.0),
    ),
    max_size=12,
)


@pytest.fixture(scope="module")
def swarm():
    """Trees of robots that know their heights, each with the place of its first robot known.

    Returns:
        What they sensed, and their true centers [R], shape (N, 3).
    """
    log, truth = structure(Rule(kind="tree", untied=0.06), 60, 3)
    log = with_heights(log, truth)
    first = np.unique(pose_problem(log, SHORT).part, return_index=True)[1]
    first = np.sort(first)[1:]
    robot, axis = np.repeat(first, 2), np.tile(np.arange(2), len(first))
    width = np.tile([0.05, -1.0], (len(robot), 1))
    fixes = np.column_stack([robot, np.eye(3)[axis], truth[robot, axis], width])
    return dataclasses.replace(log, fixes=fixes), truth


def test_a_plane_that_alone_holds_its_part_pulls_however_far_the_part_is(swarm):
    """The robust loss would let go of it, and then nothing would bring the part back."""
    log, _ = swarm
    known = pose_problem(log, SHORT)
    annealer = annealer_of([log], [SHORT], [known])
    away = annealer.by_robot(annealer.swarm.position)
    away += 40.0 * known.part[:, None]
    annealer.memory.refill(annealer.swarm.position, away[:, annealer.order].reshape(-1, 3))

    annealer.advance(1)

    assert known.part.max() > 1
    forces = annealer.by_robot(annealer.swarm.motion)[..., : BodyMotion.MASS]
    size = 2.0 / (ANNEALING.growing * SHORT.steps)
    for k in range(SHORT.chains):
        slow, _ = oracle.joint_force(
            log, known, away[k], np.zeros(len(known.part)), 0.3, 3.0, SHORT.extension_prior, size
        )
        np.testing.assert_allclose(forces[k, 1:], slow[1:], rtol=1e-9, atol=1e-10)


def test_branches_move_unless_a_robot_of_theirs_is_measured(swarm):
    """Along each axis by itself; a part moves toward where its root is known, the anchor never."""
    log, truth = swarm
    leaf = len(truth) - 1
    at_leaf = [leaf, 0.0, 1.0, 0.0, truth[leaf, 1], 0.1, -1.0]
    some = dataclasses.replace(log, fixes=np.vstack([log.fixes, at_leaf]))
    known = pose_problem(some, SHORT)

    annealer = annealer_of([some], [SHORT], [known])

    table = annealer.trees.table.to_numpy()
    first = set(np.unique(known.part, return_index=True)[1].tolist())
    assert set(known.roots.tolist()) == first
    branches = [set(annealer.order[a:b].tolist()) for a, b in table[:, [0, 2]]]
    for robots, free in zip(
        branches, table[:, SubtreeLabel.MOVES : SubtreeLabel.MOVES + 3].tolist(), strict=True
    ):
        assert free == [0 not in robots, not {0, leaf} & robots, robots <= first - {0}]
    for part in range(1, known.part.max() + 1):
        assert set(np.flatnonzero(known.part == part).tolist()) in branches


@given(measured=PLANES)
def test_planes_are_alone_where_nothing_else_measures_along_them(measured):
    """By ranks: without a plane that is alone, its part is less determined than with it."""
    planes = _planes(measured)

    is_redundant = planes.is_redundant(PART)

    for row, robot in enumerate(planes.robot):
        mine = np.flatnonzero(PART[planes.robot] == PART[robot])
        rank = [
            np.linalg.matrix_rank(planes.direction[rows]) if len(rows) else 0
            for rows in (mine, mine[mine != row])
        ]
        assert is_redundant[row] == (PART[robot] == PART[0] or rank[0] == rank[1])


@given(measured=PLANES)
def test_centers_meet_their_planes_as_least_squares_do(measured):
    """Coordinates that planes leave open are not measured; the others are the likeliest."""
    planes = _planes(measured)

    center, is_measured = planes.centers(ROBOTS)

    crowd = planes.crowd(ROBOTS)
    for robot in range(ROBOTS):
        mine = np.flatnonzero(planes.robot == robot)
        normal = planes.direction[mine]
        weight = np.sqrt(planes.precision[mine])
        value = (normal * planes.point[mine]).sum(axis=1)
        best = np.linalg.lstsq(weight[:, None] * normal, weight * value)[0] if len(mine) else 0.0
        span = np.linalg.pinv(normal) @ normal if len(mine) else np.zeros((3, 3))
        np.testing.assert_array_equal(is_measured[robot], np.diag(span) > 1.0 - 1e-9)
        np.testing.assert_allclose((span @ center[robot]), best, atol=1e-9)
        assert planes.rank(ROBOTS)[robot] == np.linalg.matrix_rank(span)
        others = np.abs(normal @ normal.T) - np.eye(len(mine)) > 1e-9
        np.testing.assert_array_equal(crowd[mine], np.where(others.any(axis=1), 3.0, 1.0))


def test_coordinates_that_we_make_up_are_no_measurements(swarm):
    """Parts that nothing ties are put somewhere, which determines nothing of them."""
    log, _ = swarm
    untied = dataclasses.replace(log, fixes=np.empty((0, 7)))
    cues = SHORT.used_cues

    known = pose_problem(untied, SHORT)

    left = observability(untied, cues)
    assert known.untied.any()
    assert known.underdetermination == pytest.approx(1.0 - len(known.rows) / left.unknowns)
    assert len(known.planes.robot) - len(known.rows.places.value) == 2 * known.part.max()
    assert not known.planes.is_redundant(known.part)[len(known.rows.places.value) :].any()


def test_memory_is_linear_in_the_fixes_of_a_robot(swarm):
    """A camera gives thousands; 30,000 once took more than 10 GB."""
    log, truth = swarm
    count = 10_000
    axis = np.tile(np.eye(3), (count, 1))
    fixes = np.column_stack(
        [
            np.full(3 * count, 9),
            axis,
            np.tile(truth[9], count),
            np.tile([0.1, -1.0], (3 * count, 1)),
        ]
    )
    many = dataclasses.replace(log, fixes=fixes)

    tracemalloc.start()
    known = pose_problem(many, SHORT)
    known.planes.crowd(60)
    known.planes.is_redundant(known.part)
    place, is_measured = known.sensed_place()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert peak < 1_000 * 3 * count  # a thousand bytes a fix
    assert is_measured[9].all()
    np.testing.assert_allclose(place[9], truth[9])


def _planes(measured):
    robot = np.array([row[0] for row in measured], np.int64)
    direction = np.array([DIRECTIONS[row[1]] for row in measured]).reshape(-1, 3)
    value, precision = (np.array([row[k] for row in measured]) for k in (2, 3))
    return Planes(
        robot=robot,
        direction=direction,
        point=direction * value[:, None],
        walk=np.zeros((len(robot), 2)),
        precision=precision,
    )
