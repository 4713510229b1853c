"""Generalized least squares over the robots near one that joined, all others as they are.

Each robot brings a block of rows. These are about itself and earlier robots: those of a log in
which the anchor and the robots that it names only stand, and it alone sensed anything. Noise of its
earlier stances is in several of its rows at once; the covariance of two rows is d N e, with d and e
the derivatives of the rows by its center and N a matrix that no position changes.

The cost is that of `WholeCost`: rows in their covariance, turns of final orientations as unknowns,
and overlaps of docks that do not touch.

`candidates` finds where a robot that joins may be: minima of its own rows, all other robots as they
are. Two distances leave a circle and three leave two mirror images, so that rows of one robot often
fit at several places. Steps begin at points all over the sphere of its sharpest distance. Turns of
the robot's final orientation are noise here, which is in several of its rows. Lengths in R.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.localization.cost import EXTENSION
from tiswarm.localization.cost.cost import Cost, State, grouped, shortened
from tiswarm.localization.online.kernels import (
    COORDINATE,
    DISTANCE,
    HINGE,
    OFFSET,
    BelievedRobots,
    RobotState,
    RowLabel,
    RowState,
    RowValue,
    Scratch,
    Table,
    WalkedRow,
    Whitening,
    descend,
    sum_equations,
)
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING, Measurements

_HELD = 1e-4
"""Standard deviation of motions that do not count [R]: no error of a measurement is as small."""

_PARTS = 6
"""Unknowns of a robot: its shift and its turn."""

_LAPACK: Any = scipy.linalg.lapack
"""Its functions have no types, and cost less to call than those above them."""
_GOLDEN = np.pi * (1.0 + 5.0**0.5)


class Shapes(NamedTuple):
    """What no estimate changes of N robots."""

    arm: Reals
    """Center to dock at the final stance, as sensed [R], shape (N, docks, 3)."""

    turn_sd: Reals
    """Standard deviation of each final orientation about each axis [rad], shape (N, 3)."""

    touch: NDArray[np.int32]
    """Contacts by the later robot: its dock, an earlier robot, the dock of that one, (T, 3)."""

    touch_start: NDArray[np.int32]
    """First contact of each robot, shape (N + 1,)."""

    gone: set[int]
    """Robots that have left, whose docks are in nobody's way."""

    @classmethod
    def of_none(cls, docks: int) -> "Shapes":
        """Begin without robots; each is to have so many docks."""
        return cls(
            arm=np.empty((0, docks, AXES)),
            turn_sd=np.empty((0, AXES)),
            touch=np.empty((0, 3), np.int32),
            touch_start=np.zeros(1, np.int32),
            gone=set(),
        )

    def with_robot(
        self, arm: Reals, turn_sd: Reals, touching: set[tuple[int, int, int]]
    ) -> "Shapes":
        """Append a robot; arguments are as the fields."""
        touch = np.array(sorted(touching), np.int32).reshape(-1, 3)
        return Shapes(
            np.concatenate([self.arm, arm[None]]),
            np.concatenate([self.turn_sd, turn_sd[None]]),
            np.concatenate([self.touch, touch]),
            np.append(self.touch_start, np.int32(len(self.touch) + len(touch))),
            self.gone,
        )

    @property
    def reach(self) -> float:
        """Distance of two centers beyond which no docks overlap [R]."""
        # All robots have the same docks.
        return 2.0 * float(np.linalg.norm(self.arm[0], axis=1).max()) + SPACING


def robots_at(state: State, shapes: Shapes, stays: Reals | float = 0.0) -> BelievedRobots:
    """Put robots where they are, as kernels take them.

    Args:
        state: Where they are.
        shapes: All N robots.
        stays: Standard deviation of each coordinate of those that do not move [R], shape (N,).
    """
    gone = np.zeros(len(shapes.arm))
    gone[[*shapes.gone]] = 1.0
    columns = RobotState.pack(
        POSITION=state.position,
        TURN=state.turn,
        TURN_SD=shapes.turn_sd,
        STAYS=np.broadcast_to(stays, len(gone)),
        GONE=gone,
    )
    return BelievedRobots(columns, shapes.arm, shapes.touch, shapes.touch_start)


@dataclass(frozen=True, kw_only=True)
class Block:
    """The m rows of one robot."""

    rows: Measurements
    """The rows, about robots numbered as in `members`, the robot itself last."""

    members: Ints
    """Index of each robot that the block knows in the whole structure: the anchor, robots named by
    the rows, and the robot itself, shape (M,)."""

    number: NDArray[np.int32]
    """The rows as kernels take them: `Table.number`, shape (m, 3)."""

    real: Reals
    """The same: `Table.real`, shape (m, 15)."""

    noise: Reals
    """The noise of earlier stances: `Table.noise`, shape (m, 29)."""

    about: Ints
    """Which of the members rows are about, ascending, shape (k,)."""

    turn_sd: Reals
    """Standard deviation of the robot's final orientation about each axis [rad], shape (3,)."""

    arm: Reals
    """Center to dock at the final stance [R], shape (docks, 3)."""

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.rows)

    @property
    def partners(self) -> Ints:
        """Earlier robots that rows are about, ascending, shape (k,)."""
        return self.members[self.about]

    def with_final_noise(self) -> Reals:
        """Return `noise` with that of the robot's final orientation, shape (m, 29)."""
        return _walked(self.rows, has_final_noise=True)


def block_of(rows: Measurements, members: Ints) -> Block:
    """Lay out the rows of the last robot of a log, the only one that sensed anything.

    Args:
        rows: Those of the robot, after the anchor and those that it names; the anchor is at the
            origin.
        members: Index of each robot in the whole structure, shape (M,).
    """
    odometry = rows.odometry
    last = rows.robots - 1
    # Where other robots were measured to be is in the blocks of their own.
    rows = rows.select((rows.robot == last) & (rows.robot > 0))
    final = odometry.final[last]
    # The final orientation is an unknown beside the position; earlier ones are noise.
    tail = np.where(rows.is_walked[:, None], odometry.reached[final], rows.first_parts())
    about, place = np.unique(rows.neighbor, return_inverse=True)
    number, real = _columns(rows, place, tail)
    return Block(
        rows=rows,
        members=members,
        number=number,
        real=real,
        noise=_walked(rows, has_final_noise=False),
        about=about,
        turn_sd=odometry.axis_sd[final],
        arm=odometry.arm[odometry.final[last]],
    )


def _columns(rows: Measurements, place: Ints, tail: Reals) -> tuple[NDArray[np.int32], Reals]:
    """Write rows as `Table` has them; the other robot of each pair has a place among partners."""
    distances = len(rows.distances.stance)
    offsets = len(rows.offsets.stance)
    coordinates = len(rows.places.stance)
    row_number = np.arange(len(rows))
    kind = np.repeat([DISTANCE, OFFSET, COORDINATE], [distances, offsets, coordinates])
    kind[:distances] = np.where(rows.distances.is_hinge, HINGE, DISTANCE)
    # The three rows of a vector are one measurement.
    part = np.where(kind == OFFSET, (row_number - distances) % AXES, 0)
    no_arm = np.zeros((coordinates, AXES))
    number = RowLabel.pack(
        KIND=kind,
        MEMBER=np.concatenate([1 + place, np.zeros(coordinates, np.int64)]),
        FIRST=row_number - part,
    ).astype(np.int32)
    real = RowValue.pack(
        AXIS=np.concatenate(
            [
                np.zeros((distances, AXES)),
                rows.offsets.axis,
                rows.places.direction,
            ]
        ),
        ARM=rows.arm,
        TAIL=tail,
        NEIGHBOR_ARM=np.concatenate([rows.neighbor_arm, no_arm]),
        VALUE=np.concatenate([rows.distances.length, np.zeros(offsets), rows.places.value]),
        OWN_VARIANCE=rows.own_variance,
        VARIANCE=rows.variance(),
    )
    return number, real


def _turns(part: Reals, sd: Reals) -> Reals:
    """Derivatives of d . (w x part), with w in sd: rows for each axis of d, (n, 3, 3)."""
    turns: Reals = np.cross(np.eye(AXES), part[:, None]) * np.broadcast_to(sd, part.shape)[:, None]
    return turns


def _walked(rows: Measurements, *, has_final_noise: bool) -> Reals:
    """Write the noise of stances as `Table.noise` has it.

    Args:
        rows: Those of one robot.
        has_final_noise: Whether the final orientation is noise, too.
    """
    odometry = rows.odometry
    order = np.argsort(-rows.stance, kind="stable")
    stance = rows.stance[order]
    sd = odometry.axis_sd
    if not has_final_noise:
        sd[odometry.final] = 0.0
    shift = _turns(odometry.reached, sd)
    square = shift @ shift.swapaxes(1, 2)
    later = odometry.sums_of_later(square)[stance]
    before = np.roll(stance, 1)
    is_new = stance != before
    skipped = later - np.roll(later, 1, axis=0) - square[before]
    shift = shift[before]
    is_new[:1] = True
    shift[:1] = 0.0
    skipped[:1] = later[:1]
    return WalkedRow.pack(
        ROW=order,
        IS_NEW=is_new,
        SHIFT=shift.reshape(-1, AXES**2),
        SKIPPED=np.where(is_new[:, None], skipped.reshape(-1, AXES**2), 0.0),
        TURN=_turns(rows.first_parts()[order], sd[stance]).reshape(-1, AXES**2),
    )


def table_of(blocks: list[Block]) -> Table:
    """Put the rows of blocks one after the other, as kernels take them."""
    member: list[Ints] = []
    for block in blocks:
        member += [block.members[-1:], block.partners]
    size = [(len(b), 1 + len(b.about)) for b in blocks]
    return Table(
        block=np.cumsum([(0, 0), *size], axis=0, dtype=np.int32),
        member=np.concatenate(member).astype(np.int32),
        number=np.concatenate([b.number for b in blocks]),
        real=np.concatenate([b.real for b in blocks]),
        noise=np.concatenate([b.noise for b in blocks]),
    )


def scratch_for(blocks: list[Block]) -> Scratch:
    """Make room for the largest of some blocks."""
    rows = max(map(len, blocks))
    # An overlap has two members.
    values = _PARTS * max(2, *(1 + len(b.about) for b in blocks)) + 1 + AXES
    return Scratch(
        factor=np.empty((rows, Whitening.TOTAL)),
        row=np.empty((rows, RowState.TOTAL)),
        value=np.empty((values, rows)),
        place=np.empty(values, np.int32),
    )


@dataclass(kw_only=True)
class NearLinear:
    """The cost near a state: cost + 2 slope . step + step . information . step.

    Steps are those of K robots, all shifts [R] and then all turns [1].
    """

    cost: float
    """Squares of rows and overlaps, priors of turns, and the loss of robust rows beyond that."""

    information: Reals
    """Shape (6 K, 6 K)."""

    slope: Reals
    """Shape (6 K,)."""

    of_others: Reals
    """Change of the slope by a common shift of all other robots, weighed by their sd, (6 K, 3)."""

    square: Reals
    """Chi-square of the rows of each block, by their robust loss where they give way, (B,)."""

    overlap: Reals
    """Greatest overlap of each robot [standard deviations], shape (K,)."""

    holds_anchor: bool
    """Whether the first robot is the anchor, which only turns."""

    def _factor(self, damping: Reals | float, held: Reals | None = None) -> Reals:
        """Damp shifts, hold the anchor, and factor the information: all turns, then all shifts.

        Args:
            damping: Precision that each coordinate has beside its rows [R^-2], shape (3 K,).
            held: Orthonormal motions that do not happen, shape (3 K, n).

        Returns:
            The lower Cholesky factor, shape (6 K, 6 K).
        """
        count = len(self.slope) // 2
        information = np.roll(self.information, count, axis=(0, 1))
        shifts = np.arange(count, 2 * count)
        information[shifts, shifts] += damping
        if held is not None:
            information[count:, count:] += _HELD**-2.0 * (held @ held.T)
        if self.holds_anchor:
            # The anchor stays where it is, but its orientation is as noisy as any.
            anchor = shifts[:AXES]
            information[anchor] = 0.0
            information[:, anchor] = 0.0
            information[anchor, anchor] = 1.0
        # Symmetric: its transpose is the same matrix in the order that needs no copy.
        factor: Reals
        factor, trouble = _LAPACK.dpotrf(information.T, lower=1, overwrite_a=1)
        if trouble:
            raise np.linalg.LinAlgError("the information of a neighborhood is not positive")
        return factor

    def step(self, radius: float) -> tuple[Reals, Reals]:
        """Solve for the shifts and the turns of all robots that may move, (K, 3) both.

        Shifts much beyond a radius [R] are damped.
        """
        slope = self.slope.copy()
        if self.holds_anchor:
            slope[:AXES] = 0.0
        count = len(slope) // 2
        step, _ = _LAPACK.dpotrs(self._factor(radius**-2.0), -np.roll(slope, count), lower=1)
        shift, turn = np.roll(step, count).reshape(2, -1, AXES)
        return shift, turn

    def sd(
        self, open_precision: Reals | float = NEIGHBORS.open_precision, held: Reals | None = None
    ) -> Reals:
        """Compute the standard deviation of each robot that may move [R], shape (K,).

        Errors of the robots that stay count as a shift that they share.

        Args:
            open_precision: Precision of what nothing determines [R^-2], shape (3 K,).
            held: Orthonormal motions that do not count, shape (3 K, n).
        """
        count = len(self.slope) // 2
        factor = self._factor(open_precision, held)
        others = np.roll(self.of_others, count, axis=0)
        if self.holds_anchor:
            others[count : count + AXES] = 0.0
        # Turns come first: the last rows of the factor are that of what is known of the shifts
        # alone, and the variance is the square of its inverse.
        half, _ = _LAPACK.dtrtrs(factor, others, lower=1)
        inverse, _ = _LAPACK.dtrtri(factor[count:, count:], lower=1)
        inverse = np.tril(inverse)
        row_variance = (inverse**2).sum(axis=0)
        # A neighborhood hangs on robots that are wrong themselves, and by much the same.
        shared = inverse.T @ half[count:]
        square = row_variance + (shared**2).sum(axis=1)
        if self.holds_anchor:
            square[:AXES] = 0.0
        sd: Reals = np.sqrt(square.reshape(-1, AXES).sum(axis=1))
        return sd


class NearCost(Cost[NearLinear]):
    """The cost of `WholeCost` as a function of K robots that may move; others are constants.

    A kernel sums it over the B blocks with rows about these robots: of ten robots in a fifth of the
    time that sparse matrices take, of sixty in less than half. For a hundred these are quicker.
    """

    # Most joins need one step; each costs as much as the first.
    most_rounds = NEIGHBORS.rounds
    widest = NEIGHBORS.radius
    least_reduction = NEIGHBORS.settled

    def __init__(
        self,
        rows: list[Block],
        moving: Ints,
        stays_sd: Reals | float = 0.0,
        *,
        shapes: Shapes,
        robust_sd: float | None = None,
        non_overlap: bool = True,
    ) -> None:
        """Gather what does not change with the state.

        Args:
            rows: Blocks with rows about the robots that may move; none is empty.
            moving: These robots, ascending, shape (K,); the anchor only turns.
            stays_sd: Standard deviation of the positions of robots that stay [R], shape (N,).
            shapes: All N robots.
            robust_sd: Width of Cauchy's loss in standard deviations; squares count if None.
            non_overlap: Whether docks that do not touch must not overlap.
        """
        self.moving = moving
        self.shapes = shapes
        self.robust_sd = robust_sd
        self.non_overlap = non_overlap
        self.number = {int(block.members[-1]): k for k, block in enumerate(rows)}
        self.table = table_of(rows)
        self._scratch = scratch_for(rows)
        self._column = np.full(len(shapes.arm), -1, np.int32)
        self._column[moving] = np.arange(len(moving))
        # Three axes share the variance.
        self._stays = np.where(self._column < 0, stays_sd / np.sqrt(AXES), 0.0)

    def linearized(self, state: State) -> NearLinear:
        """Linearize the cost at a state."""
        moving = self.moving.astype(np.int32)
        count = _PARTS * len(moving)
        total = np.zeros((count + AXES + 1, count + AXES + 1))
        square = np.empty(len(self.number) + 1)
        overlap = np.zeros(len(moving))
        sum_equations(
            (self.robust_sd or 0.0) ** 2, int(self.non_overlap), self.shapes.reach,
            *self.table, *robots_at(state, self.shapes, self._stays), *self._scratch,
            moving, self._column, total, square, overlap,
        )  # fmt: skip
        off = state.turn[self.moving].ravel()
        # A turn is in standard deviations, so that its prior has precision 1.
        of_turns = np.arange(len(off), count)
        slope = total[-1, :count].copy()
        slope[of_turns] += off
        lower = total[:count, :count]
        information = lower + np.tril(lower, -1).T
        information[of_turns, of_turns] += 1.0
        return NearLinear(
            cost=float(total[-1, -1] + off @ off + square[-1]),
            information=information,
            slope=slope,
            of_others=total[count:-1, :count].T,
            square=square[:-1],
            overlap=overlap,
            holds_anchor=bool(self.moving[0] == 0),
        )

    def moved(self, state: State, linear: NearLinear, radius: float) -> tuple[State, float]:
        """Step robots that may move, and their turns."""
        shift, turn = linear.step(radius)
        shift = shortened(shift, NEIGHBORS.longest_step)
        position = state.position.copy()
        turned = state.turn.copy()
        position[self.moving] += shift
        turned[self.moving] += turn
        step = np.concatenate([shift.ravel(), turn.ravel()])
        return State(position, turned), float(-linear.slope @ step)

    def missed(self, linear: NearLinear, robot: int) -> tuple[float, float]:
        """Chi-square of the rows of a robot, and its greatest overlap in standard deviations."""
        return float(linear.square[self.number[robot]]), float(linear.overlap[self._column[robot]])


def candidates(
    block: Block, state: State, shapes: Shapes, *, non_overlap: bool
) -> tuple[Reals, Reals]:
    """Find the places of the robot of a block, the most likely one first.

    Args:
        block: Its rows, at least one of them about another robot.
        state: Where all others are.
        shapes: All robots.
        non_overlap: Whether docks that do not touch must not overlap.

    Returns:
        Centers [R], shape (k, 3), and their costs less what extension gains [1], shape (k,).
    """
    robots = robots_at(state, shapes)
    # Its own turn is noise of its rows.
    robots.state[block.members[-1], RobotState.TURN : RobotState.TURN_SD] = 0.0
    table = table_of([block])._replace(noise=block.with_final_noise())
    place = _starts(block, state)
    cost = np.empty(len(place))
    count = np.empty(1, np.int32)
    descend(
        int(non_overlap), shapes.reach, *table, *robots, *scratch_for([block]),
        np.empty((AXES + 1, AXES + 1)), place, cost, count,
    )  # fmt: skip
    ends = place[: count[0]]
    return _distinct(ends, cost[: count[0]] - extension(block, state, ends))


def extension(block: Block, state: State, place: Reals) -> Reals:
    """Compute what a robot at some places (n, 3) gains by its extension [1], shape (n,)."""
    touched = state.position[block.partners]
    apart = np.linalg.norm(place[:, None] - touched, axis=2).mean(axis=1)
    gain: Reals = 2.0 * EXTENSION * apart
    return gain


def _sphere(count: int) -> Reals:
    """Spread points evenly over the unit sphere, along a golden spiral, shape (count, 3)."""
    number = np.arange(count) + 0.5
    z = 1.0 - 2.0 * number / count
    angle = _GOLDEN * number
    level = np.sqrt(1.0 - z**2)
    return np.column_stack([level * np.cos(angle), level * np.sin(angle), z])


SPHERE = _sphere(CANDIDATES.starts)
"""Where steps begin, on the unit sphere, shape (starts, 3)."""


def _starts(block: Block, state: State) -> Reals:
    """Spread starts over the sphere that the sharpest distance leaves, shape (starts, 3).

    Where only vectors are measured, the sphere is that of the sharpest of them.
    """
    pairs = len(block.rows.neighbor)
    sharpest = int(block.real[:pairs, RowValue.VARIANCE].argmin())
    row = block.real[sharpest]
    at = state.position[block.members[block.rows.neighbor[sharpest]]]
    center = at + row[RowValue.NEIGHBOR_ARM : RowValue.VALUE] - row[RowValue.ARM : RowValue.TAIL]
    # A vector has the distance, too: that of two docks in contact.
    radius = SPACING
    if block.number[sharpest, RowLabel.KIND] < OFFSET:
        radius = row[RowValue.VALUE]
    start: Reals = center + radius * SPHERE
    return start


def _distinct(place: Reals, cost: Reals) -> tuple[Reals, Reals]:
    """Keep the best of ends that are close, as far as their costs let them be candidates."""

    def is_close(n: int, kept: list[int]) -> Bools:
        apart = np.linalg.norm(place[kept] - place[n], axis=1)
        return np.asarray(apart <= CANDIDATES.distinct)

    order = np.argsort(cost, kind="stable")
    likely = order[~(cost[order] > cost[order[0]] + CANDIDATES.worst)]
    kept = [group[0] for group in grouped(likely, is_close)][: CANDIDATES.most]
    return place[kept], cost[kept]
