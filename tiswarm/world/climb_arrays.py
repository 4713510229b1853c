"""Arrays and numbers of robots that climb: their structure, themselves, their walks."""

from typing import NamedTuple

from tiswarm.compute.cell_kernels import CellList
from tiswarm.compute.lang import (  # fmt: skip
    F64,
    I32,
    Ints1,
    Ints2,
    Ints3,
    Ints4,
    Reals2,
    Reals3,
    kernel_struct,
)

FLAT, EDGE = 1, 2
"""Ground that a dock stands on; 0 for none."""
MAX_TOUCHING = 12
"""No more unit spheres than this can touch one (the kissing number)."""


@kernel_struct
class ClimbLimits:
    """Numbers that do not change during a climb; see `ClimbParams` and `Terrain`."""

    spacing: F64
    contact_gap: F64
    ground_z: F64
    left_edge: F64
    right_edge: F64
    min_flip: F64
    max_flip: F64
    revisit_distance: F64
    full_turn: F64
    reach: F64
    inverse_edge: F64
    twists: I32
    is_planar: I32
    by_belief: I32


class StructureArrays(NamedTuple):
    """S structures with room for N robots of n docks each; n i + k is dock k of robot i."""

    cells: CellList
    """The joined docks by place."""

    dock: Reals3
    """Dock centers [R]; rows of robots that have not joined are meaningless, (S, n N, 3)."""

    relay: Ints2
    """Call that each dock passes on; a robot that touches a positive one is recruited, (S, n N)."""

    robot_count: Ints1
    """Robots that have joined, shape (S,)."""


class BelievedDocks(NamedTuple):
    """The joined docks where robots believe them; those of `StructureArrays` if they know."""

    cells: CellList
    """The docks by believed place."""

    dock: Reals3
    """Dock centers [R], shape (S, n N, 3)."""


class Climbers(NamedTuple):
    """Robots that climb at the same time, one slot each."""

    structure: Ints1
    """Structure that each slot's robots climb, ascending, shape (slots,)."""

    first_stance: Ints1
    """Stance to go on from; those before it are kept, shape (slots,)."""

    goal: Reals2
    """Goal of each [R], shape (slots, 3)."""

    patience: Ints1
    """Steps in a row without a new best with which each gives up; 0 to stay where it starts."""

    settles: Ints1
    """Whether each turns, where it stays, until a third dock touches."""

    dock_offset_body: Reals2
    """Center to dock in the body frame [R], shape (n, 3)."""

    near: Reals3
    """Scratch: vectors from the pivot to docks in reach, as believed, shape (slots, near, 3)."""

    obstacle: Reals3
    """Scratch: the same as they are, for robots that do not know, shape (slots, near, 3)."""


class WalkArrays(NamedTuple):
    """Stances of the climbers' walks, by slot."""

    center: Reals3
    """Centers [R], shape (slots, stances, 3)."""

    orientation: Reals3
    """Body to world, wxyz, shape (slots, stances, 4)."""

    pivot_dock: Ints2
    """Dock that stays put as the robot leaves a stance, shape (slots, stances)."""

    touching: Ints4
    """Docks of the structure that each dock touches, or -1, (slots, stances, n, MAX_TOUCHING)."""

    on_ground: Ints3
    """0, FLAT or EDGE, shape (slots, stances, n)."""

    last: Ints1
    """Last stance of each walk, shape (slots,)."""

    best: Ints1
    """Best stance of each walk, shape (slots,)."""

    stay: Ints1
    """Stance where each robot stays, settled or not, shape (slots,)."""
