"""Rigid motions of some robots about others that change no measurement, or less than noise does.

Ranges alone leave a swarm free to turn about its anchor, and do not exclude its mirror image.
Ranges to robots in a line leave a robot, or several that range to each other, free to turn about
that line; ranges to one robot leave them free to turn about it. What changes no measurement changes
no likelihood: such turns are uniform (Haar's measure). The mean over a circle or a sphere of radius
r, which has the least mean square error, is its center, and that error is r^2. Lengths in R.
"""

from collections.abc import Iterator
from itertools import chain, combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.compute.normal_equations import factored
from tiswarm.measurements.contacts import connected_parts, disconnected, spans
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import Measurements
from tiswarm.records.estimate import OpenTurn

_UNRESISTED = 1e-6
"""Change of a measurement for each R of motion below which it does not resist [1]."""

_ANGLES = 48
"""Angles about a line at which measurements are compared."""

_DRAWS = 256
"""Draws of all turns together."""

_BROAD = 0.1
"""Mean likelihood of these angles, relative to the best one, from which on a turn is free [1]: the
linear problem knows the width of smaller arcs."""

_RARE = 1e-3
"""Share of mirror images in the likelihood, up to which none counts [1]."""

_STRAIGHT = 0.25
"""Width of a line of robots up to which others may turn about it, in its length [1]."""

_MOST_CUT = 16
"""Robots of unknown place up to which each two of them are tried as an axis: that takes time."""

_MOST_ROBOTS = 1000
"""Robots up to which sets that turn are looked for at all: that takes time, too."""

_MOST_UNKNOWNS = 20_000
"""Unknowns of configurations that are solved at once; more take memory."""


class Turn(NamedTuple):
    """Free turns of some of N robots about one robot, or about a line of several."""

    moves: Bools
    """Robots that move, shape (N,)."""

    about: Ints
    """Robots that stay: one, or several in the order in which they stand along the axis, (n,)."""

    axes: Reals
    """Orthonormal axes: none, one, or three (two that move a line), shape (k, 3)."""

    is_hand_free: bool
    """Whether a mirror image, in a plane through these axes, meets the measurements as well."""

    chance: Reals = np.repeat([1.0, 0.0], _ANGLES)
    """Relative likelihood of equal angles about a single axis, and of these after a mirror image
    [1], shape (2 _ANGLES,)."""

    is_frame: bool = False
    """Whether the robots only have a shape, and nothing says how it stands in the world."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names as in `Estimate.free_frame`."""
        turns = {0: (), 1: ("axis",)}.get(len(self.axes), ("rotation",))
        return (*turns, *(["hand"] if self.is_hand_free else []))

    def pivot(self, position: Reals) -> tuple[Reals, Reals]:
        """Return the center and the axes of turns in configurations (..., N, 3)."""
        center = position[..., self.about, :].mean(axis=-2)
        if len(self.about) == 1:
            return center, np.broadcast_to(self.axes, (*center.shape[:-1], *self.axes.shape))
        line = position[..., self.about[-1], :] - position[..., self.about[0], :]
        axis: Reals = line / np.linalg.norm(line, axis=-1, keepdims=True)
        return center, axis[..., None, :]

    def turned(self, position: Reals, matrix: Reals) -> Reals:
        """Multiply arms of K configurations (K, N, 3) by matrices (K, 3, 3)."""
        center = self.pivot(position)[0][:, None]
        return np.where(self.moves[:, None], center + (position - center) @ matrix, position)

    def drawn(self, position: Reals, stream: int) -> Reals:
        """Turn each of `_DRAWS` configurations (_DRAWS, N, 3) at random.

        Angles are stratified, and rotations come with half turns, so that centers are exact.
        """
        axes = self.pivot(position)[1]
        if axes.shape[1] == 1:
            order = np.argsort(normal(stream, "order of turns", np.arange(_DRAWS), 0))
            level = np.concatenate([[0.0], np.cumsum(self.chance)])
            place = np.interp((order + 0.5) / _DRAWS, level / level[-1], np.arange(len(level)))
            return self.turned(position, _motions(axes[:, 0], place))
        quaternion = normal(stream, "turns", np.arange(_DRAWS // 4)[:, None], np.arange(4))
        turns = 2.0 * np.eye(AXES)[:, :, None] * np.eye(AXES) - np.eye(AXES)
        half = np.concatenate([np.eye(AXES)[None], turns])
        matrices = half[:, None] @ Rotation.from_quat(quaternion).as_matrix()
        return self.turned(position, matrices.reshape(-1, AXES, AXES))


class Turns(tuple[Turn, ...]):  # noqa: SLOT001 - it has no attributes
    """Free turns of one structure of N robots, that of its frame first, then larger sets first."""

    @classmethod
    def of(cls, rows: Measurements, position: Reals, among: Bools | None = None) -> "Turns":
        """Find all, at positions where measurements are met [R], shape (N, 3).

        A set of robots may turn that shares rows with one other robot, or with several in a line.
        Sets are what hangs together once one or two robots, or none, are taken away.
        No frame is found if only those `among` robots may turn, shape (N,).
        """
        part = connected_parts(rows)
        near = np.zeros((rows.robots, rows.robots), np.bool_)
        tied = part == part[0]
        of_pair = rows.robot[: len(rows.neighbor)]
        measured = spans(rows.robot[len(rows.neighbor) :], rows.places.direction, rows.robots)
        is_placed = np.linalg.matrix_rank(measured, hermitian=True) == AXES
        is_placed[0] = True
        frame = free_frame(rows, position, tied & (among is None))
        # Nothing of the world but the anchor is known, and robots that move have a shape.
        is_frame = bool(frame.names) and not (is_placed & tied)[1:].any()
        is_frame &= bool((tied[of_pair] & (of_pair > 0) & (rows.neighbor > 0)).any())
        turns = [frame._replace(is_frame=True)] if is_frame else []
        is_placed |= among is not None and ~among
        if rows.robots > _MOST_ROBOTS or not rows.is_central.any():
            return cls(turns)
        near[of_pair, rows.neighbor] = True
        near[rows.neighbor, of_pair] = True
        for members in _sets(near, np.flatnonzero(~is_placed & ~disconnected(rows))):
            moves = np.isin(np.arange(rows.robots), members)
            about = np.flatnonzero(near[members].any(axis=0) & ~moves)
            if len(about) and not (is_frame and tied.sum() == len(members) + len(about)):
                turn = _turn_about(rows, position, moves, about)
                turns += [turn] if turn.names else []
        return cls(turns)

    def aligned(self, *chains: Reals, to: int) -> Iterator[Reals]:
        """Turn K configurations (K, N, 3), and others like them, to be nearest to one of them."""
        goal = chains[0][to]
        for turn in self:
            matrices = align(chains[0], goal, turn)
            chains = tuple(turn.turned(chain, matrices) for chain in chains)
        return iter(chains)

    def motions(self, position: Reals) -> Reals:
        """Orthonormal motions of robots at positions (N, 3) by free turns, shape (3 N, n)."""
        columns = []
        for turn in self:
            center, axes = turn.pivot(position)
            columns.append(_turning(axes, (position - center) * turn.moves[:, None]))
        motion, size, _ = np.linalg.svd(np.concatenate(columns, axis=1), full_matrices=False)
        return np.asarray(motion[:, size > _UNRESISTED * size[0]])

    def swept(self, position: Reals) -> tuple[Reals, Reals]:
        """Average positions (N, 3) over all turns but that of a frame, by draws of all together.

        Returns:
            Means [R], shape (N, 3), and mean square distances from these [R^2], shape (N,).
        """
        draws = np.tile(position, (_DRAWS, 1, 1))
        for stream, turn in enumerate(self):
            draws = draws if turn.is_frame else turn.drawn(draws, stream)
        moved = (draws != position).any(axis=(0, 2))
        mean = np.where(moved[:, None], draws.mean(axis=0), position)
        return mean, ((draws - mean) ** 2).sum(axis=2).mean(axis=0)

    def off(self, position: Reals, stated: Reals) -> Reals:
        """Average squares of distances from centers (N, 3), 0 of those that stay [R^2], (N,)."""
        mean, square = self.swept(position)
        return np.where(square > 0.0, square + ((stated - mean) ** 2).sum(axis=1), 0.0)

    def stated(self, position: Reals, unit: float) -> dict[str, Any]:
        """Write them as fields of an estimate, for positions (N, 3) and R in the log's unit."""
        frame: tuple[str, ...] = ()
        open_turns: dict[tuple[int, ...], OpenTurn] = {}
        for turn in self:
            if turn.is_frame:
                frame = turn.names
                continue
            (center, axes) = turn.pivot(position)
            key = tuple(turn.about.tolist())
            robots = np.flatnonzero(turn.moves)
            if key in open_turns:
                robots = np.union1d(robots, open_turns[key].robots)
            # Noise has put robots beside their line, where they would resist the turn.
            along = (position[turn.about] - center) @ axes[0]
            line = center + along[:, None] * axes[0]
            place = unit * np.concatenate([position[robots], line])
            axis = axes[0] if len(axes) == 1 else None
            open_turns[key] = OpenTurn(robots=robots, about=turn.about, axis=axis, place=place)
        return {"free_frame": frame, "turns": tuple(open_turns.values())}


def free_frame(rows: Measurements, position: Reals, moves: Bools, about: int = 0) -> Turn:
    """Find the rigid motions of some robots about one of them that change no measurement.

    Args:
        rows: Measurements.
        position: Centers where these are met [R], shape (N, 3).
        moves: Robots that move, shape (N,).
        about: Robot about which they turn.
    """
    held = Turn(moves, np.array([about]), np.empty((0, AXES)), is_hand_free=False)
    arm = (position - position[about]) * moves[:, None]
    extent = np.linalg.norm(arm)
    if not extent:
        return held
    turns = _turning(np.eye(AXES), arm)
    changed = rows.jacobian(position)[:, : turns.shape[0]] @ turns
    _, size, axes = np.linalg.svd(np.linalg.qr(np.asarray(changed), mode="r"))
    size = np.pad(size, (0, AXES - len(size)))
    moved = np.linalg.norm(turns @ axes.T, axis=0)
    axes = axes[(size <= _UNRESISTED * extent) & (moved > _UNRESISTED * extent)]

    def is_free(moved_arm: Reals) -> bool:
        """Whether robots with these arms meet the measurements as well."""
        image = np.where(moves[:, None], position[about] + moved_arm, position)
        change = rows.residual(image) - rows.residual(position)
        return bool(np.abs(change).max(initial=0.0) <= _UNRESISTED * extent)

    # What resists to second order only does so after a turn by 1 rad.
    axes = axes[[is_free(Rotation.from_rotvec(axis).apply(arm)) for axis in axes]]
    if not len(axes):
        return held
    return held._replace(axes=axes, is_hand_free=is_free(_mirrored(arm, axes)))


def _sets(near: Bools, robots: Ints) -> list[Ints]:
    """List sets of some robots that hang together by `near` (N, N), the largest first."""
    most = AXES if len(robots) <= _MOST_CUT else 1
    sets = {(i,) for i in robots.tolist() if near[i].sum() <= AXES - 1}
    for cut in chain(*(combinations(robots.tolist(), count) for count in range(most))):
        rest = np.setdiff1d(robots, cut)
        _, label = connected_components(near[np.ix_(rest, rest)], directed=False)
        sets |= {tuple(rest[label == k].tolist()) for k in np.unique(label)}
    return [
        np.array(members) for members in sorted(sets, key=lambda members: (-len(members), members))
    ]


def _turn_about(rows: Measurements, position: Reals, moves: Bools, about: Ints) -> Turn:
    """Find how robots are free to turn about those that they share rows with."""
    touched = moves[rows.robot]
    touched[: len(rows.neighbor)] |= moves[rows.neighbor]
    rows = rows.select(touched).averaged()
    if len(about) == 1:
        return free_frame(rows, position, moves, int(about[0]))
    arm = position[about] - position[about].mean(axis=0)
    _, size, axes = np.linalg.svd(arm, full_matrices=False)
    about = about[np.argsort(arm @ axes[0], kind="stable")]
    arm = (position - position[about].mean(axis=0))[moves]
    least = _UNRESISTED * np.linalg.norm(arm)
    is_line = least < size[0] and size[1] <= _STRAIGHT * size[0]
    turn = Turn(moves, about, axes[:1], is_hand_free=False)
    held = turn._replace(axes=axes[:0])
    if not is_line or np.linalg.norm(np.cross(axes[:1], arm)) <= least:
        return held
    axes = turn.pivot(position)[1]
    place = np.arange(2 * _ANGLES, dtype=np.float64) + 0.5
    every: Reals = np.tile(position, (len(place), 1, 1))
    every = turn.turned(every, _motions(np.tile(axes[0], (len(place), 1)), place))
    every = np.concatenate([every, position[None]])
    few = max(1, _MOST_UNKNOWNS // (3 * len(arm)))
    pieces = (every[k : k + few] for k in range(0, len(every), few))
    square = np.concatenate([_least_squares(rows, piece, turn) for piece in pieces])
    chance = np.exp(0.5 * (square.min() - square[:-1]))
    # Images of a single robot are turns, too: they make no arc wider.
    if chance.reshape(2, -1).sum(axis=1).max() < _BROAD * _ANGLES:
        return held
    is_hand_free = bool(chance[_ANGLES:].sum() > _RARE * chance.sum())
    return turn._replace(chance=chance, is_hand_free=is_hand_free)


def _least_squares(rows: Measurements, position: Reals, turn: Turn) -> Reals:
    """Compute the chi-square of K turned configurations, each at the nearest minimum, shape (K,).

    Robots may move to it, to first order, but not on by the turn.

    Args:
        rows: Measurements about the robots that turn.
        position: Configurations [R], shape (K, N, 3).
        turn: The turn, whose direction at each configuration is a motion that does not count.
    """
    members = np.flatnonzero(turn.moves)
    column = np.cumsum(turn.moves) * turn.moves - 1  # -1 of robots that stay
    sd = np.sqrt(rows.variance())
    count = len(position)
    size = AXES * len(members)
    residual, way = rows.linearized(position)
    residual = residual / sd
    way = way / sd[:, None]
    center, axes = turn.pivot(position)
    along = np.cross(axes, (position - center[:, None])[:, members]).reshape(count, size)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    entries = []
    number = np.arange(count)[:, None, None]
    for robot, slope in ((rows.robot, way), (rows.neighbor, -way[:, : len(rows.neighbor)])):
        row = np.flatnonzero(turn.moves[robot])
        place = (AXES * column[robot[row], None] + np.arange(AXES)) + size * number
        line = row[:, None] + len(rows) * number
        entries.append([slope[:, row], np.broadcast_to(line, place.shape), place])
    value, line, place = (
        np.concatenate([part.ravel() for part in of_ends]) for of_ends in zip(*entries, strict=True)
    )
    jacobian = csr_matrix((value, (line, place)), shape=(count * len(rows), count * size))
    information = (jacobian.T @ jacobian).tocsc()  # a block for each configuration
    pull = (jacobian.T @ residual.ravel()).reshape(count, size)
    # We minimize |J d + e|^2 under a^T d = 0, with the direction a of the turn: the pull loses its
    # part along a, and a multiple of H^-1 a takes the step back to a^T d = 0 (Lagrange multiplier).
    # H is singular where further motions are free, and a itself may be one: a stiffness far below
    # that of any measurement makes it regular. It counts in what measurements resist beside a, so
    # that it stays small where a is nearly all that they resist.
    pull -= (pull * along).sum(axis=1, keepdims=True) * along
    most = information.diagonal().reshape(count, size).sum(axis=1)
    most -= (along * (information @ along.ravel()).reshape(count, size)).sum(axis=1)
    stiff = diags(np.repeat(_UNRESISTED * most, size), format="csc")
    factor = factored(information + stiff, pivots="largest")
    step, held = (factor.solve(side.ravel()).reshape(count, size) for side in (pull, along))
    step -= held * ((along * step).sum(axis=1) / (along * held).sum(axis=1))[:, None]
    least: Reals = (residual**2).sum(axis=1) - (pull * step).sum(axis=1)
    return least


def align(position: Reals, goal: Reals, turn: Turn) -> Reals:
    """Move robots by free motions so that they are nearest to where others are (Kabsch 1976).

    Args:
        position: Centers of K configurations [R], shape (K, N, 3).
        goal: Centers to be near to [R], shape (N, 3).
        turn: Free motions.

    Returns:
        Orthogonal matrices that rows of arms from the pivot are multiplied by, shape (K, 3, 3).
    """
    matrices = np.tile(np.eye(AXES), (len(position), 1, 1))
    if not len(turn.axes):
        return matrices
    goal_arm = (goal - turn.pivot(goal)[0])[turn.moves]
    for k, centers in enumerate(position):
        center, axes = turn.pivot(centers)
        arm = (centers - center)[turn.moves]
        images = [arm, _mirrored(arm, axes)] if turn.is_hand_free else [arm]
        mirror = [np.eye(AXES), _mirrored(np.eye(AXES), axes)]
        turns = [_turn(image, goal_arm, axes) for image in images]
        off = [
            np.linalg.norm(image @ turn - goal_arm)
            for image, turn in zip(images, turns, strict=True)
        ]
        best = int(np.argmin(off))
        matrices[k] = mirror[best] @ turns[best]
    return matrices


def _motions(axis: Reals, place: Reals) -> Reals:
    """Return matrices (K, 3, 3) for arms: turns about axes (K, 3) by `place` angles.

    Places from `_ANGLES` on are turns that follow a mirror image.
    """
    matrices = Rotation.from_rotvec(-2.0 * np.pi / _ANGLES * place[:, None] * axis).as_matrix()
    for k in np.flatnonzero(place >= _ANGLES).tolist():
        matrices[k] = _mirrored(np.eye(AXES), axis[k : k + 1]) @ matrices[k]
    return matrices


def _turning(axes: Reals, arm: Reals) -> Reals:
    """Velocities of arms (N, 3) that turn about axes (n, 3) at 1 rad/s, shape (3 N, n)."""
    velocity = np.cross(axes[:, None], arm).astype(np.float64)
    return velocity.reshape(len(axes), arm.size).T


def _mirrored(arm: Reals, axes: Reals) -> Reals:
    """Mirror arms in a plane that contains the axis of free turns, or in any if all are free."""
    along = axes[0]
    across = np.cross(along, np.eye(AXES)[np.abs(along).argmin()])
    across /= np.linalg.norm(across)
    mirrored: Reals = arm - 2.0 * (arm @ across)[..., None] * across
    return mirrored


def _turn(arm: Reals, goal_arm: Reals, axes: Reals) -> Reals:
    """Find the free turn that brings arms (n, 3) nearest to others: a matrix to multiply by."""
    if len(axes) == 1:
        basis = np.linalg.svd(axes)[2]  # the axis first
        (_, a, b) = (arm @ basis.T).T
        (_, c, d) = (goal_arm @ basis.T).T
        angle = np.arctan2((a * d - b * c).sum(), (a * c + b * d).sum())
        cos = np.cos(angle)
        sin = np.sin(angle)
        inner = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
        turn: Reals = basis.T @ inner @ basis
        return turn
    u, _, vt = np.linalg.svd(arm.T @ goal_arm)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    proper: Reals = u @ sign @ vt
    return proper
