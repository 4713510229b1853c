"""Rigidity analysis: motions of the swarm that change no measurement to first order.

The floppy modes are the kernel of the rigidity matrix, the Jacobian of the measurements by all
positions (and by all yaws where these are unknown); its constraints are bars between the docks of
robots whose orientations are known (Maxwell 1864; Thorpe 1983). Lengths in R.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.compute.normal_equations import factored
from tiswarm.measurements.model import Measurements

_UNNOTICED = 1e-5
"""A motion is floppy where all that is measured changes by less than this part of its length."""

SHIFTED = 0.1
"""A robot is floppy where floppy motions shift it by more than this part of what they shift an
unconstrained robot."""

_SHIFTS = 3
"""Degrees of freedom of a robot that does not turn: x, y and z."""

_PROBES = 16
MOST_UNKNOWNS = 400_000
"""Matrices of more are not factored: too much memory. Those of 100,000 robots take some 1 GB."""

MOST_LOOPS = 80_000
"""Matrices of bodies with more independent loops are not factored: in solid swarms, time grows as
the square of their size. A grown tower has 0.6 loops a robot, a block of honeycomb layers 2.6."""


class _Constraints(NamedTuple):
    """Constraints between bodies, all between the same two taken together."""

    first: AnyInts
    second: AnyInts
    stiffness: Reals
    """Sum of the outer products of their rows in the rigidity matrix, shape (pairs, dof, dof)."""


class Bodies(NamedTuple):
    """Robots that cannot move against each other, taken as one."""

    of_robot: AnyInts
    """Body of each robot and of the world, shape (N + 1,)."""

    lever: Reals
    """From the center of its body to that of each of them [R], shape (N + 1, 3)."""

    center: Reals
    """Mean of the centers of each body's robots, seen from the anchor [R], shape (bodies, 3)."""

    constraints: _Constraints

    @property
    def size(self) -> int:
        """Bodies in all."""
        return len(self.center)

    @property
    def dof(self) -> int:
        """Degrees of freedom of each: 4 where yaw is unknown, else 3."""
        return self.constraints.stiffness.shape[1]

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of all but the world."""
        return self.dof * (self.size - 1)

    @property
    def fixed(self) -> int:
        """Body of the world, which stays where it is."""
        return int(self.of_robot[-1])

    @property
    def has_gauge_yaw(self) -> bool:
        """Whether the swarm as a whole is free to turn about the anchor (a gauge freedom)."""
        if self.dof == _SHIFTS or (self.of_robot[:-1] == self.fixed).any():
            return False
        of_world = (self.constraints.first == self.fixed) | (self.constraints.second == self.fixed)
        return not self.constraints.stiffness[of_world, _SHIFTS, _SHIFTS].any()

    @property
    def floppy_modes(self) -> int | None:
        """Number of independent motions that change no measurement; None for too large structures.

        These are dim ker R, with R the rigidity matrix. Bodies whose constraints are independent
        are peeled off first; the rest has as many floppy modes as its stiffness matrix R^T R has
        eigenvalues below _UNNOTICED^2. Where yaw is unknown a turn of the whole swarm about the
        anchor does not count: the mean of all compasses fixes it.
        """
        peeled, core = _peel(self)
        if _is_too_large(core):
            return None
        factors = _factors(core)
        core_modes = 0 if factors is None else int((factors.U.diagonal() < 0.0).sum())
        return peeled + core_modes - self.has_gauge_yaw


def weld(rows: Measurements, position: Reals, *, yaw_unknown: bool = False) -> Bodies:
    """Join robots that cannot move against each other into bodies, until no more can be joined.

    Robots move by x, y and z, and where their yaw is unknown by a fourth coordinate, their turn
    about the vertical through the anchor. Then x, y and z are what they move along that axis: all
    motions have one point of reference, so that only their differences count.

    Args:
        rows: Measurements.
        position: Centers at which to linearize them [R], shape (N, 3).
        yaw_unknown: Whether yaw is unknown, one angle for all stances of a robot. What is known of
            such angles beforehand is no measurement: it is off by degrees.
    """
    # The world is one more body, at the anchor: heights and places tie robots to it.
    center = np.concatenate([position - position[0], np.zeros((1, 3))])
    direction = _directions(rows, position, yaw_unknown=yaw_unknown)
    dof = direction.shape[1]
    world = rows.robots
    places = len(rows.places.value)
    # The world holds the anchor in all directions, and each measured coordinate in one.
    first = np.concatenate([rows.neighbor, np.full(places + _SHIFTS, world)])
    second = np.concatenate([rows.robot, np.zeros(_SHIFTS, np.int64)])
    way = np.concatenate([direction, np.eye(_SHIFTS, dof)])
    count = len(center)
    body: AnyInts = np.arange(count)
    held = _Constraints(first, second, way[:, :, None] * way[:, None, :])
    while True:
        held = _summed(held, count)
        members = np.bincount(body, minlength=count)[:, None]
        mean = np.column_stack([np.bincount(body, axis) for axis in center.T]) / members
        # Seen from the anchor's axis, eigenvalues would grow with the distance of bodies from it.
        seen = _seen_from(mean[held.first], held.stiffness)
        stiff = _rank(seen) == dof
        if not stiff.any():
            return Bodies(body, center - mean[body], mean, held)
        # Joined bodies share the constraints of all their robots, by which further pairs may be
        # stiff: hence the loop.
        graph = coo_array(
            (np.ones(stiff.sum()), (held.first[stiff], held.second[stiff])), shape=(count, count)
        )
        count, joined = connected_components(graph, directed=False)
        body = joined[body]
        held = _Constraints(joined[held.first], joined[held.second], held.stiffness)


def common_motions(
    rows: Measurements, position: Reals, part: NDArray[np.int32], *, yaw_unknown: bool
) -> int:
    """Count the independent motions of all robots tied to the anchor as one body.

    They change no measurement, and neither move nor turn the anchor.

    Args:
        rows: Measurements.
        position: Centers at which to linearize them [R], shape (N, 3).
        part: Connected part of each robot, shape (N,); that of the anchor moves.
        yaw_unknown: Whether the body may turn about the vertical, too.
    """
    direction = _directions(rows, position, yaw_unknown=yaw_unknown)
    moves = part == part[0]
    moves[0] = False
    # A row resists where one of its ends moves with the body and the other does not.
    moves_partner = np.concatenate(
        [moves[rows.neighbor], np.zeros(len(rows.places.value), np.bool_)]
    )
    resisted = direction[moves[rows.robot] != moves_partner]
    dof = direction.shape[1]
    return dof - int(np.linalg.matrix_rank(resisted, tol=_UNNOTICED)) if moves.any() else 0


def _directions(rows: Measurements, position: Reals, *, yaw_unknown: bool) -> Reals:
    """Differentiate measurements by the motion of their robots, shape (E, dof).

    A turn is about the vertical through the anchor.
    """
    direction = rows.linearized(position)[1]
    if not yaw_unknown:
        return direction
    x, y, _ = (position[rows.robot] - position[0] + rows.arm).T
    return np.column_stack([direction, direction[:, 1] * x - direction[:, 0] * y])


class Further(NamedTuple):
    """Further rows of the rigidity matrix, few of them."""

    matrix: Reals
    """By the motions of all bodies but the world's about their own centers, (rows, unknowns)."""

    fixes_yaw: bool
    """Whether they resist a turn of the whole swarm about the anchor."""


class FloppyMotions:
    """Random motions that change no measurement.

    Of random motions x, -s (K - s 1)^-1 x with s = _UNNOTICED^2 is the part that the stiffness
    matrix K does not resist. A few further rows update the inverse (Woodbury 1950), so that one
    factorization serves all candidates for a further measurement.
    """

    def __init__(self, bodies: Bodies) -> None:
        """Draw motions of bodies."""
        self.bodies = bodies
        self._factors = _factors(bodies)
        coordinate = np.arange(bodies.unknowns)[:, None]
        self._floppy = self._unresisted(normal(0, "floppy motion", coordinate, np.arange(_PROBES)))

    def of_robots(self, further: Further | None = None) -> Reals:
        """Compute what neither the measurements nor further rows resist.

        Returns:
            Shift of each center and, where yaw is unknown, its turn, shape (N, dof, _PROBES).
        """
        bodies = self.bodies
        motion = self._floppy
        if further is not None:
            rows = further.matrix
            held = self._unresisted(rows.T)
            resisted = rows @ held - _UNNOTICED**2 * np.eye(len(rows))
            # Woodbury's formula with every term multiplied by -s, as `held` and `left` are.
            motion = motion - held @ np.linalg.solve(resisted, rows @ motion)
        motion = motion.reshape(-1, bodies.dof, _PROBES)
        moved = np.insert(motion, bodies.fixed, 0.0, axis=0)[bodies.of_robot[:-1]]
        if bodies.dof > _SHIFTS:
            # A body turns about its own center and takes its robots along.
            moved[:, :2] += _swept(moved[:, _SHIFTS], bodies.lever[:-1])
        return np.asarray(moved)

    def robots(self, further: Further | None = None) -> Bools:
        """Find the robots that floppy motions shift, shape (N,); arguments as in `of_robots`.

        Where the swarm may turn as a whole, we subtract the mean turn.
        """
        moved = self.of_robots(further)
        bodies = self.bodies
        if bodies.has_gauge_yaw and not (further and further.fixes_yaw):
            from_anchor = bodies.center[bodies.of_robot[:-1]] + bodies.lever[:-1]
            moved[:, :2] -= _swept(moved[:, _SHIFTS].mean(axis=0), from_anchor)
        shifted = np.sqrt(np.mean(moved[:, :_SHIFTS] ** 2, axis=(1, 2)))
        return np.asarray(shifted > SHIFTED)

    def _unresisted(self, motion: Reals) -> Reals:
        """Compute the part of motions that measurements do not resist, shape (unknowns, n)."""
        if self._factors is None:
            return motion
        return np.asarray(-(_UNNOTICED**2) * self._factors.solve(motion))


def floppy_motions(bodies: Bodies) -> FloppyMotions | None:
    """Draw random motions that change no measurement; None for too large structures."""
    return None if _is_too_large(bodies) else FloppyMotions(bodies)


def further_rows(bodies: Bodies, rows: Measurements, position: Reals) -> Further:
    """Differentiate a few further measurements by the motions of bodies.

    Args:
        bodies: Bodies that other measurements of the same robots have joined.
        rows: Further measurements.
        position: Centers at which to linearize them [R], shape (N, 3).
    """
    world = rows.robots
    dof = bodies.dof
    direction = _directions(rows, position, yaw_unknown=dof > _SHIFTS)
    partner = np.concatenate([rows.neighbor, np.full(len(rows.places.value), world)])
    matrix = np.zeros((len(rows), bodies.size, dof))
    for sign, robot in ((1.0, rows.robot), (-1.0, partner)):
        body = bodies.of_robot[robot]
        way = sign * direction[:, None]
        if dof > _SHIFTS:
            way = way @ _from(bodies.center[body])
        matrix[np.arange(len(rows)), body] += way[:, 0]
    free = np.delete(matrix, bodies.fixed, axis=1).reshape(len(rows), -1)
    turns = direction[len(rows.neighbor) :, _SHIFTS:]
    return Further(free, bool(turns.any()))


def _is_too_large(bodies: Bodies) -> bool:
    """Whether factoring the stiffness matrix of bodies would take too much memory or time."""
    first, second, _ = bodies.constraints
    between = int(((first != bodies.fixed) & (second != bodies.fixed)).sum())
    # A spanning tree of the bodies has no loop, and each further constraint closes one.
    return bodies.unknowns > MOST_UNKNOWNS or between - (bodies.size - 1) > MOST_LOOPS


def _swept(turn: Reals, arm: Reals) -> Reals:
    """Displacements by turns (..., _PROBES) of the ends of arms (N, 3), shape (N, 2, _PROBES)."""
    x, y, _ = arm.T[:, :, None]
    return np.stack([-turn * y, turn * x], axis=1)


def _summed(constraints: _Constraints, bodies: int) -> _Constraints:
    """Sum constraints of the same two bodies, and drop those of a body with itself."""
    apart = constraints.first != constraints.second
    low, high = np.sort(np.stack([constraints.first[apart], constraints.second[apart]]), axis=0)
    pair, row = np.unique(low.astype(np.int64) * bodies + high, return_inverse=True)
    total = _by_row(row, constraints.stiffness[apart], len(pair))
    return _Constraints(pair // bodies, pair % bodies, total)


def _by_row(row: AnyInts, matrix: Reals, rows: int) -> Reals:
    """Sum square matrices that belong to the same row, shape (rows, dof, dof)."""
    dof = matrix.shape[1]
    total = np.empty((rows, dof**2))
    for place, entry in enumerate(matrix.reshape(-1, dof**2).T):
        total[:, place] = np.bincount(row, entry, rows)
    return total.reshape(-1, dof, dof)


def _from(center: Reals) -> Reals:
    """Change of reference point for body motions, from their own centers to the anchor's axis.

    Shape (..., 4, 4).
    """
    change = np.tile(np.eye(4), (*center.shape[:-1], 1, 1))
    change[..., 0, 3] = center[..., 1]
    change[..., 1, 3] = -center[..., 0]
    return change


def _seen_from(center: Reals, stiffness: Reals, second_center: Reals | None = None) -> Reals:
    """Express stiffness by motions of bodies about their own centers, not the anchor's axis."""
    if stiffness.shape[1] == _SHIFTS:  # the same from everywhere
        return stiffness
    seen: Reals = (
        _from(center).swapaxes(1, 2)
        @ stiffness
        @ _from(center if second_center is None else second_center)
    )
    return seen


def _rank(stiffness: Reals) -> Ints:
    """Count the directions that are constrained, shape (rows,)."""
    rank: Ints = (np.linalg.eigvalsh(stiffness) > _UNNOTICED**2).sum(axis=1)
    return rank


def _peel(bodies: Bodies) -> tuple[int, Bodies]:
    """Peel off bodies whose constraints are independent, as long as there are some.

    The constraints of such a body hold it and nothing else: without both, the others are as free as
    they were with them.

    Returns:
        Floppy modes of what was peeled off, and the rest.
    """
    constraints = bodies.constraints
    center = bodies.center
    rank = _rank(_seen_from(center[constraints.first], constraints.stiffness))
    rests = np.ones(bodies.size, np.bool_)
    modes = 0
    while True:
        end = np.concatenate([constraints.first, constraints.second])
        total = np.bincount(end, np.tile(rank, 2), bodies.size)
        held = _rank(
            _seen_from(center, _by_row(end, np.tile(constraints.stiffness, (2, 1, 1)), bodies.size))
        )
        # Where the ranks of the parts add up to that of the sum, no constraint repeats another.
        peels = rests & (total == held)
        peels[bodies.fixed] = False
        if not peels.any():
            break
        rests &= ~peels
        cut = peels[constraints.first] | peels[constraints.second]
        modes += bodies.dof * int(peels.sum()) - int(rank[cut].sum())
        constraints = _Constraints(*(column[~cut] for column in constraints))
        rank = rank[~cut]
    number = np.cumsum(rests) - 1
    core_constraints = _Constraints(
        number[constraints.first], number[constraints.second], constraints.stiffness
    )
    core = Bodies(number[[bodies.fixed]], np.zeros((1, 3)), center[rests], core_constraints)
    return modes, core


def _factors(bodies: Bodies) -> SuperLU | None:
    """Factor K - s 1, K being the stiffness matrix of all bodies but the fixed one.

    By Sylvester's law of inertia it has as many negative pivots as K has eigenvalues below s.
    """
    if bodies.size == 1:
        return None
    first, second, stiffness = bodies.constraints
    row = np.concatenate([first, second, first, second])
    column = np.concatenate([first, second, second, first])
    # As in a Laplacian: a constraint adds to both bodies, and couples them by its negative.
    block = np.concatenate([stiffness, stiffness, -stiffness, -stiffness])
    block = _seen_from(bodies.center[row], block, bodies.center[column])
    free = (row != bodies.fixed) & (column != bodies.fixed)
    row = row[free]
    column = column[free]
    block = block[free]
    row = row - (row > bodies.fixed)
    column = column - (column > bodies.fixed)
    dof = np.arange(bodies.dof)
    unknowns = bodies.unknowns
    rows = np.broadcast_to(len(dof) * row[:, None, None] + dof[:, None], block.shape)
    columns = np.broadcast_to(len(dof) * column[:, None, None] + dof, block.shape)
    matrix = csc_array((block.ravel(), (rows.ravel(), columns.ravel())), shape=(unknowns, unknowns))
    return factored(csc_array(matrix - _UNNOTICED**2 * eye_array(unknowns)))
