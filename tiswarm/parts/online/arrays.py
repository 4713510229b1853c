"""Arrays of the tracker's kernels, in bundles that the host allocates and kernels hand on.

A table has a name for each of its columns, or for the first of several that form a vector.
Lengths in R.
"""

from typing import NamedTuple

from tiswarm.compute.lang import Ints1, Ints2, Reals1, Reals2, Reals3

ROW, NOISE, MEMBERS = range(3)
"""Columns of `Table.block`: where the rows, the noise and the members of a block begin."""

KIND, MEMBER, FIRST = range(3)
"""Columns of `Table.number`: kind of a row, the other robot's place among the members, and the
row of the block in which its measurement begins."""

DISTANCE, HINGE, OFFSET, COORDINATE = range(4)
"""Kinds of rows; only distances that are too short count of a hinge."""

AXIS, ARM, TAIL, OTHER_ARM, VALUE, OWN_VARIANCE, VARIANCE = 0, 3, 6, 9, 12, 13, 14
"""Columns of `Table.real`: what a row measures along, the arm, the part of it that the final
orientation turns, the other arm, the measured value, and variances [R^2]."""

REALS = 15
"""Columns of `Table.real`."""

POSITION, TURN, TURN_SD, STAYS, GONE, STATE = 0, 3, 6, 9, 10, 11
"""Columns of `BelievedRobots.state`: the center, the error of the orientation in standard
deviations, these [rad], the sd of each coordinate of a robot that does not move [R], and 1 for a
robot that has left; then how many they are."""

DIRECTION, ITS_DIRECTION, RESIDUAL, WIDENED, SEEN = 0, 3, 6, 7, 8
"""Columns of `Scratch.row`: the derivative by the robot's center and by its turn [R], what is
missed, the row's own variance as far as it gives way, and how many these are."""


class Table(NamedTuple):
    """The rows of B blocks, one after the other: E rows, M members."""

    block: Ints2
    """ROW, NOISE and MEMBERS of each block, and where the last one ends, shape (B + 1, 3)."""

    member: Ints1
    """BelievedRobots of each block: its own, then its partners ascending, shape (M,)."""

    number: Ints2
    """Columns from KIND on, shape (E, 3)."""

    real: Reals2
    """Columns from AXIS on, shape (E, REALS)."""

    noise: Reals1
    """As in `Block`, block after block."""


class BelievedRobots(NamedTuple):
    """N robots."""

    state: Reals2
    """Columns from POSITION on, shape (N, STATE)."""

    arm: Reals3
    """Center to dock at the final stance, as sensed [R], shape (N, docks, 3)."""

    touch: Ints2
    """Own dock, the other robot and its dock, for each contact of the later robot, shape (T, 3)."""

    touch_start: Ints1
    """First contact of each robot, shape (N + 1,)."""


class Scratch(NamedTuple):
    """Room for one block of m rows."""

    covariance: Reals2
    """Covariance, then its Cholesky factor, shape (m, m)."""

    row: Reals2
    """Columns from DIRECTION on, shape (m, SEEN)."""

    value: Reals2
    """Derivatives by each unknown, then what `Linearized.of_others` is of, then the residual: a
    row for each, shape (U, m)."""

    place: Ints1
    """Place of each of these among all unknowns, shape (U,)."""
