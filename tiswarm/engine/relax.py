"""The swarm step: every robot at once, moved by the forces on its docks.

    F_i = sum over connected docks of Eq. (1)
        + sum over other docks of other robots nearer than D of Eq. (2)
        + k_z (h_i - z_i) along z, Eq. (3)
    p_i <- p_i + F_i, no farther than the longest step

Equations as in `tiswarm.engine.kernels`. Lengths in the unit of the robot's spacing D.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tiswarm.aliases import Ints, Reals
from tiswarm.compute import backend, program
from tiswarm.compute.backend import Allocator, Backend
from tiswarm.compute.neighbor_list import MOST_ITEMS, NeighborList, morton_order
from tiswarm.engine import kernels
from tiswarm.engine.kernels import Gains, Robots
from tiswarm.engine.places import Places
from tiswarm.engine.structure_kernels import relax_structures
from tiswarm.errors import InputError
from tiswarm.params import AnyArch, AnyPrecision, Precision
from tiswarm.robot import Robot

_SKIN = 0.25
"""Reach of rows of neighbors beyond D [D]."""
SMALL = 2_000
"""Most robots of a structure that one thread relaxes by itself, without a pause."""
_STEPS, _STEPS_ON_CARD = 4, 16
"""Most steps of a call. On a card Python needs longer for a call than the card for its steps; rows
serve some 13, and the card skips the rest."""
_CALLS = 2
"""Calls on a processor between two questions whether rows are stale."""
_DIVERGED = "the forces diverged; lower the gains or give max_step"
_NO_LIMIT = 1e30
_LARGEST_GAIN = 1e12
_NORM_SLACK = 1e-6
"""Largest deviation of a quaternion's norm from 1."""


@dataclass(frozen=True, kw_only=True)
class RelaxResult:
    """Where the robots came to rest, or are on the way."""

    position: Reals
    """Centers, in the caller's order, shape (N, 3)."""

    largest_move: Reals
    """Longest step of any robot, by step, shape (steps,)."""

    list_builds: int
    """How often rows of neighbors were made, in the structure that needed it most."""

    precision: Precision
    """Floating-point type that the device computed in."""

    force_error: float
    """Largest error of a force by rounding [1]: relative to the largest force, or to that of two
    docks D / 2 from touching, connected or not, where that is larger."""


@program.exclusive()
def relax(
    position: ArrayLike,
    orientation_wxyz: ArrayLike,
    contacts: ArrayLike,
    *,
    robot: Robot,
    attraction_gain: float,
    repulsion_gain: float,
    ramp: float | Sequence[float] | Reals,
    steps: int,
    height: ArrayLike | None = None,
    height_gain: float = 0.0,
    max_step: float | None = None,
    structure: ArrayLike | None = None,
    precision: AnyPrecision = "auto",
    arch: AnyArch = "cpu",
    threads: int | None = None,
) -> RelaxResult:
    """Take steps of the whole swarm under Eqs. (1)-(3), all robots at once.

    The bytes of the result depend on the arguments alone, not on threads.

    >>> from tiswarm.robot import RobotGeometry
    >>> places, level = [[0, 0, 0], [6, 0, 0]], [[1, 0, 0, 0]] * 2
    >>> gains = {"attraction_gain": 0.1, "repulsion_gain": 0.1, "ramp": 1.0}
    >>> result = relax(places, level, [[0, 0, 1, 0]], robot=RobotGeometry(), steps=50, **gains)
    >>> result.position[:, 0].round(3).tolist()  # connected docks touch at a distance of D = 2
    [2.0, 4.0]

    Args:
        position: Centers, shape (N, 3).
        orientation_wxyz: Body to world, unit quaternions, kept throughout, shape (N, 4).
        contacts: Connected docks, rows of (robot i, dock, robot j, dock), shape (C, 4).
        robot: Where docks are on a robot, and D; its unit of length is that of all lengths here.
        attraction_gain: A of Eq. (1) [1].
        repulsion_gain: B of Eqs. (1) and (2) [length^-3].
        ramp: alpha, the share of attraction, 0 to 1: one number, or one a step.
        steps: T.
        height: Height that each robot is pulled toward, NaN for none, shape (N,).
        height_gain: k_z of Eq. (3) [1].
        max_step: Longest step of a robot; None for no limit.
        structure: Number of each robot's structure, shape (N,); robots of different structures
            never interact. None for one structure.
        precision: f32 halves the memory and rounds the more the larger the swarm, wherever it is;
            `auto` as for `tiswarm.compute.backend.choose`.
        arch: Device; it computes there or an error is raised. `auto` takes a card if one works.
        threads: CPU threads; all that this process may use if None.

    Raises:
        InputError: an argument makes no sense, or forces diverge.
        EnvironmentTroubleError: the machine lacks the device or the memory.
    """
    swarm = PreparedSwarm(
        position, orientation_wxyz, contacts, robot=robot, height=height, structure=structure,
        precision=precision, arch=arch, threads=threads,
    )  # fmt: skip
    return swarm.relax(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, ramp=ramp, steps=steps,
        height_gain=height_gain, max_step=max_step,
    )  # fmt: skip


class PreparedSwarm:
    """A swarm on the device, to be relaxed again and again; arguments as for `relax`.

    Robots are renumbered, so that neighbors are near in memory. A guided swarm has inertia and a
    mobility of each robot m, and its connected docks part where they are nearer than D:

        step <- momentum * step + m F, no longer than the longest step
    """

    @program.exclusive()
    def __init__(
        self,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        robot: Robot,
        height: ArrayLike | None = None,
        mobility: ArrayLike | None = None,
        structure: ArrayLike | None = None,
        precision: AnyPrecision = "auto",
        arch: AnyArch = "cpu",
        threads: int | None = None,
        running: Backend | None = None,
    ) -> None:
        """Check the robots, renumber them and copy them to the device.

        A `mobility`, the step of each robot along each axis for a force of 1 [1], shape (N, 3),
        makes the swarm guided; 0 fixes a coordinate. `running` is a backend that runs already.
        """
        self.start_position = center = _shaped("position", position, ("N", 3))
        robots = len(center)
        orientation = _shaped("orientation_wxyz", orientation_wxyz, (robots, 4))
        norm = np.linalg.norm(orientation, axis=1)
        if not (np.isfinite(center).all() and (np.abs(norm - 1.0) < _NORM_SLACK).all()):
            raise InputError(
                "positions must be finite and orientations unit quaternions (w, x, y, z)"
            )
        ids: Ints = np.zeros(robots, np.int64)
        if structure is not None:
            named = _shaped("structure", structure, (robots,))
            ids = np.unique(named, return_inverse=True)[1].astype(np.int64)
        body, self.spacing = robot.dock_offset_body, robot.spacing
        connected = _checked_contacts(contacts, len(body), ids)
        target = None if height is None else _shaped("height", height, (robots,))
        self.guided = mobility is not None
        share = np.ones((1, 1)) if mobility is None else _shaped("mobility", mobility, (robots, 3))
        if running is None:
            running = backend.start(arch, threads=threads, precision=precision)
        self.running = running
        if robots == 0:
            return
        reach = float(np.linalg.norm(body, axis=1).max())
        self.target = np.full(1, np.nan) if target is None else target
        self.places = Places(origin=np.zeros(3), unit=None, spacing=self.spacing)
        if running.precision == "f32":
            self.places = Places.choose(center, self.target, reach=reach, spacing=self.spacing)
        if not self.places.is_resolved(center):
            way_out = ", or use precision f64" if running.precision == "f32" else ""
            raise InputError(
                f"a robot {np.abs(center).max():.3g} from the origin is beyond what "
                f"{running.precision} resolves; bring robots nearer together{way_out}"
            )
        size = np.bincount(ids)
        self.by_structure = not running.on_card and size.max() <= SMALL
        self.order = order = morton_order(center, ids)
        self.start = np.concatenate([[0], size.cumsum()])
        per_robot = _bytes_of_robot(running.dtype, len(body), guided=self.guided)
        running.require_memory(robots * per_robot, robots)
        new = np.argsort(order)
        connected[:, [0, 2]] = new[connected[:, [0, 2]]]
        self.memory = memory = Allocator(running, on_host=self.by_structure)
        self.neighbors = NeighborList(
            memory, center[order], connected,
            docks=len(body), reach=reach, cutoff=(1.0 + _SKIN) * self.spacing,
            start=self.start if self.by_structure else None, unit=self.places.unit,
        )  # fmt: skip
        if target is not None:
            self.target = target[order]
        numbers = memory.reals if self.places.unit is None else memory.ints
        self.robots = Robots(
            position=numbers(robots, 3),
            reference=numbers(robots, 3),
            height=numbers(len(self.target)),
            arm=memory.reals(robots * len(body), 3),
            dock=numbers(2 * robots * len(body) * 4),
            mobility=memory.upload(share[order] if self.guided else share),
            last_step=memory.reals(*share.shape),
        )
        self.control, self.moves, self.ramp = memory.ints(4), memory.reals(1), memory.reals(1)
        seldom = memory.for_few_launches()
        self.structure = seldom.upload(ids[order])
        kernels.turn_docks(seldom.upload(orientation[order]), seldom.upload(body), self.robots.arm)

    @program.exclusive()
    def relax(
        self,
        *,
        attraction_gain: float,
        repulsion_gain: float,
        ramp: float | Sequence[float] | Reals,
        steps: int,
        height_gain: float = 0.0,
        max_step: float | None = None,
        parting_gain: float = 0.0,
        momentum: float = 0.0,
        resume: bool = False,
    ) -> RelaxResult:
        """Take steps from where the robots were at first, or, to `resume`, where they are.

        In a guided swarm connected docks nearer than D part by a spring of stiffness `parting_gain`
        times the ramp [1], and a robot takes the share `momentum` of its last step again [1].
        """
        ramps = np.asarray(ramp, np.float64)
        if steps < 0 or ramps.shape not in {(), (steps,)}:
            raise InputError(
                f"ramp of shape {ramps.shape}; give one number, or one for each of {steps} steps"
            )
        limit = _NO_LIMIT if max_step is None else max_step
        gains = Gains(
            attraction_gain, repulsion_gain, height_gain, self.spacing, limit, parting_gain,
            momentum,
        )  # fmt: skip
        if not (all(0.0 <= gain <= _LARGEST_GAIN for gain in gains[:3]) and limit >= 0.0):
            raise InputError(
                f"gains must be 0 to {_LARGEST_GAIN:g}, and the longest step 0 or more, "
                f"not {tuple(gains)}"
            )
        position = self.start_position.copy()
        if steps == 0 or len(position) == 0:
            at_rest = float(np.abs(position).max(initial=0.0))
            return self._result(position, np.zeros(steps), 0, at_rest)
        if backend.current() is not self.running and not self.by_structure:
            raise InputError("another device started, which freed the swarm; prepare it again")
        if not resume:
            self.position = self.start_position[self.order]
            self.last_step = np.zeros(self.robots.last_step.shape)
        relax = self._by_structure if self.by_structure else self._all_at_once
        while True:
            self._go_to_start()
            moves, builds = relax(gains, np.broadcast_to(ramps, steps))
            if not self.places.were_left(moves):
                break
            self.places = self.places.coarser()
            self.neighbors.cutoff = (1.0 + _SKIN) * self.spacing / self.places.scale
            if not self.places.is_resolved(self.start_position):
                raise InputError(f"{_DIVERGED}, or use precision f64")
        end = self.places.to_lengths(self.memory.download(self.robots.position))
        farthest = _farthest(self.position, end, moves)
        if not self.places.is_resolved(farthest):
            raise InputError(_DIVERGED)
        self.last_step = self.memory.download(self.robots.last_step)
        position[self.order] = self.position = end
        return self._result(position, moves, builds, farthest)

    def _result(self, position: Reals, moves: Reals, builds: int, farthest: float) -> RelaxResult:
        if self.running.precision == "f32" and len(position):
            # Center and dock are rounded: as coarse as real numbers in f32 so far from the origin.
            farthest = float(2.0 * self.places.scale / np.finfo(np.float32).eps)
        return RelaxResult(
            position=position,
            largest_move=moves,
            list_builds=builds,
            precision=self.running.precision,
            force_error=self.running.force_error(2.0 * farthest / self.spacing),
        )

    def _go_to_start(self) -> None:
        robots, places = self.robots, self.places
        self.memory.refill(robots.position, places.to_numbers(self.position, places.origin))
        self.memory.refill(robots.height, places.to_numbers(self.target, places.origin[2]))
        self.memory.refill(robots.last_step, self.last_step)
        kernels.place_docks(places.scale, self.structure, robots.position, robots.arm, robots.dock)

    def _all_at_once(self, gains: Gains, ramp: Reals) -> tuple[Reals, int]:
        """Step by step, each with all threads; make rows anew where they are stale."""
        neighbors, robots, control, steps = self.neighbors, self.robots, self.control, len(ramp)
        if self.moves.shape[0] != steps:
            self.moves, self.ramp = self.memory.reals(steps), self.memory.reals(steps)
        self.memory.refill(self.ramp, ramp)
        taken, builds_before, half = 0, neighbors.builds, robots.dock.shape[0] // 2
        most, calls = (_STEPS_ON_CARD, 1) if neighbors.on_card else (_STEPS, _CALLS)
        control.fill(0)
        while taken < steps:
            neighbors.build(robots.dock, taken % 2 * half)
            kernels.start_interval(robots.position, robots.reference, control)
            while not control[kernels.STALE]:
                with backend.fast_arithmetic():
                    for t in range(taken, taken + calls * most, most):
                        kernels.step_robots(
                            neighbors.on_card, most, self.guided, neighbors.docks,
                            neighbors.own_bits, neighbors.entry_stride, *gains,
                            0.5 * _SKIN * self.spacing, self.places.scale, t, self.ramp,
                            *neighbors.rows, *robots, control, self.moves,
                        )  # fmt: skip
                before, taken = taken, int(control[kernels.TAKEN])
                if taken == before:
                    raise backend.faulty_driver()
        moves = self.memory.download(self.moves).astype(np.float64)
        return moves, neighbors.builds - builds_before

    def _by_structure(self, gains: Gains, ramp: Reals) -> tuple[Reals, int]:
        """All steps of a structure on one thread; again from the start if a row was too short."""
        neighbors, structures = self.neighbors, len(self.start) - 1
        start, ramps = self.memory.upload(self.start), self.memory.upload(ramp)
        moves = self.memory.reals(structures, len(ramp))
        builds = self.memory.ints(structures)
        stray_limit = 0.5 * ((1.0 + _SKIN) * self.spacing - self.spacing)
        while True:
            with backend.fast_arithmetic():
                relax_structures(
                    self.guided, neighbors.docks, neighbors.own_bits, neighbors.cutoff, stray_limit,
                    self.places.scale, neighbors.capacity, *gains, start, ramps, neighbors.table,
                    *neighbors.cells, *neighbors.connections, *neighbors.rows, *self.robots, builds,
                    neighbors.longest, moves,
                )  # fmt: skip
            if (entries := neighbors.fullest()) <= neighbors.capacity:
                break
            neighbors.make_room(entries)
            self._go_to_start()
        return moves.max(axis=0).astype(np.float64), int(builds.max())


def _farthest(start: Reals, end: Reals, moves: Reals) -> float:
    """Bound the largest coordinate on the way from start to end, by the longest step of each."""
    way = np.concatenate([[0.0], np.cumsum(moves)])
    return float(np.minimum(np.abs(start).max() + way, np.abs(end).max() + way[-1] - way).max())


def _shaped(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> Reals:
    """Copy an array of this shape; a length that is a letter may be any."""
    expected = str(shape).replace("'", "")
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name} is no table of numbers; give an array of shape {expected}"
        ) from error
    if array.size == 0:
        array = array.reshape(0, *(int(length) for length in shape[1:]))
    wanted = tuple(len(array) if isinstance(n, str) else n for n in shape) if array.ndim else ()
    if array.shape != wanted:
        raise InputError(f"{name} has shape {array.shape}; expected {expected}")
    return array


def _checked_contacts(contacts: ArrayLike, docks: int, structure: Ints) -> Ints:
    """Contacts between docks that exist, of different robots of one structure, each once."""
    given = _shaped("contacts", contacts, ("C", 4))
    odd = given[~(np.abs(given) < MOST_ITEMS) | (given != np.rint(given))]
    if odd.size:
        raise InputError(f"contacts holds {odd[0]:g}; give whole numbers: robot, dock, robot, dock")
    rows = given.astype(np.int64)
    first, second = rows[:, [0, 2]].T
    beyond = (rows < 0) | (rows >= np.array([len(structure), docks] * 2))
    wrong = beyond.any(axis=1) | (first == second)
    if not wrong.any():
        wrong = structure[first] != structure[second]
    if wrong.any():
        raise InputError(
            f"contact {tuple(rows[wrong][0].tolist())} is not between docks 0 to {docks - 1} of "
            f"two of the {len(structure)} robots in one structure"
        )
    # One number a pair sorts far faster than rows of four do.
    one, other = first * docks + rows[:, 1], second * docks + rows[:, 3]
    most = len(structure) * docks
    pair = np.unique(np.minimum(one, other) * most + np.maximum(one, other))
    one, other = np.divmod(pair, most)
    return np.column_stack([one // docks, one % docks, other // docks, other % docks])


def _bytes_of_robot(dtype: type[np.floating[Any]], docks: int, *, guided: bool) -> int:
    """Count the memory of a robot in arrays of numbers and of integers [B]."""
    numbers, integers = (
        (5 if guided else 3) * 3 + docks * (3 + 2 * 4 + 4),
        docks * (1 + 16 + 16) + 12,
    )
    return numbers * np.dtype(dtype).itemsize + 4 * integers
