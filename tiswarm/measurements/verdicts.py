"""An estimate in words: whether to trust it, which configurations fit, and what is an outlier."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from tiswarm.base.aliases import AnyInts, Ints, Reals
from tiswarm.measurements.contacts import connected_parts, reach
from tiswarm.measurements.cues import CUES, WALKED, Measured, measure
from tiswarm.measurements.model import SPACING
from tiswarm.records.estimate import MOST_MISFIT_SD, CommonCause, Convergence, Estimate, OpenTurn
from tiswarm.records.messages import counted, percent
from tiswarm.records.sensing_log import NUMBERS, SensingLog

MOST_SHOWN = 10
"""Robots, and solutions, that a line or a list names."""

IMAGES_APART = "images apart [sd]"
"""Heading of how far a further measurement sets two solutions apart."""

_STRETCH = 1.5
"""A chain of contacts this many times as long as it can be is no error of a few dock radii."""

_FEW = 1.0 / 3.0
"""Share of the robots that carry most of a misfit, below which these are what to look at."""

_LOST = "not converged"

_MOSTLY = 0.5
"""Share of the robots from which on free motions are named [1]."""

_VERTICAL = 1.0 - 1e-6
"""Least part of an axis along z that counts as vertical [1]."""

_MOTIONS = {
    "rotation": "turned about the anchor",
    "axis": "turned about one axis through the anchor",
    "hand": "were replaced by their mirror image",
}


_REMEDIES = {
    "dock offset": "state it in the log (dock_offsets), or import again with --dock-offset",
    "dock radius": "state it in the log (dock_radius), or import again with --dock-radius",
    "scale of measured lengths": (
        "multiply these lengths by it, or divide dock_radius and dock_offsets of the log by it"
    ),
    "ground height": "state it in the log (ground_z), or import again with --ground-z",
    "shift of all heights": "add it to the heights of the log (flip_height)",
    "shift of all ranges": "add it to the ranges of the log (ranges)",
    "anchor height": "state it in the log (anchor_position)",
    "turn of the world frame of all orientations": (
        "turn the orientations of the log (orientation_wxyz), or the frame of what measured them"
    ),
    "turn of all docks in the body frame": (
        "turn the docks of the log (dock_offsets), or import again with --docks"
    ),
}
"""What to do about each common parameter that explains a misfit."""


def reasons(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """State what `cautions` does not: bad verdicts, or what limits good ones."""
    if distrust(log, estimate):
        yield verdict(estimate) or _LOST
        return
    if estimate.convergence is not None:
        yield from _untestable(estimate.convergence)
    yield from _fitting(estimate)


def in_brief(log: SensingLog, estimate: Estimate) -> str:
    """State in a line why robots may not be where they are shown; empty without a reason."""
    if distrust(log, estimate):
        return "; ".join(reasons(log, estimate))
    is_open = [*_undetermined(estimate), *_mirrored(log, estimate), *_turning(log, estimate)]
    return "; ".join([*reasons(log, estimate), *is_open])


def _untestable(convergence: Convergence) -> Iterator[str]:
    """State that too few measurements are spare to find that the log is not consistent."""
    if not convergence.testable:
        spare = counted(convergence.spare or 0, "spare measurement")
        yield f"consistency not testable ({spare}: too few to disagree)"


def verdict(estimate: Estimate) -> str:
    """Give both verdicts in a word or two; empty where the method gave none."""
    convergence = estimate.convergence
    if convergence is None:
        return ""
    if not convergence.converged:
        if convergence.consistent is False:
            return "neither converged nor consistent"
        return _LOST
    return "not consistent" if convergence.consistent is False else "converged"


def distrust(log: SensingLog, estimate: Estimate) -> str:
    """Say why an estimate cannot be trusted, and what to do; empty if it can."""
    convergence = estimate.convergence
    beyond = _beyond_reach(log, estimate)
    if convergence is None:
        if not beyond.size:
            return ""
        where = f"beyond the reach of their contacts are {named(log, beyond)}"
        return f"{_LOST}: {where}; look for wrong contacts, heights and spawn positions"
    if convergence.trusted:
        return ""
    text = verdict(estimate) + (f": {convergence.reason}" if convergence.reason else "")
    causes = estimate.common_causes
    misfit = "" if convergence.consistent is not False else describe_misfit(convergence.misfit_sd)
    if misfit:
        text += f" ({misfit})"
    clauses = [text] if convergence.converged else [text, "positions and sd may be far off"]
    if convergence.sd_factor != 1.0 and estimate.sd is not None:
        clauses.append(f"sd is multiplied by {convergence.sd_factor:.2g}")
    carriers = (
        _carriers(estimate)
        if convergence.converged and convergence.misfit_sd > 0.0 and not causes
        else np.empty(0, int)
    )
    if carriers.size:
        clauses.append(f"most of it is carried by {named(log, carriers)}")
    anchors = _outlier_anchors(log, estimate)
    if causes:
        remedy = _remedy_of(causes)
    elif anchors.size:
        remedy = "measure that position again, or leave it out of the log"
        if len(anchors) > 1:
            remedy = "measure these positions again, or leave them out of the log"
    else:
        remedy = _remedy(convergence, carriers, log, beyond)
    return "; ".join([*clauses, remedy])


def _remedy_of(causes: Sequence[CommonCause]) -> str:
    """Say what to do where one of some parameters is wrong."""
    if len(causes) == 1:
        return _REMEDIES[causes[0].parameter]
    listed = [f"{cause.parameter}: {_REMEDIES[cause.parameter]}" for cause in causes]
    return "; ".join(["measure which of them is wrong", *listed])


def _outlier_anchors(log: SensingLog, estimate: Estimate) -> Ints:
    """List the robots whose known positions are outliers."""
    if estimate.outlier_places is None:
        return np.empty(0, np.int64)
    robots = np.unique(estimate.outlier_places[:, 0])
    anchors: Ints = robots[np.isfinite(log.known_position[robots, 0])].astype(np.int64)
    return anchors


def describe_misfit(misfit_sd: float) -> str:
    """Say how far chi-square is from its expectation; empty where noise explains that."""
    if not abs(misfit_sd) > MOST_MISFIT_SD:
        return ""
    side = "exceeds" if misfit_sd > 0.0 else "is below"
    return f"chi-square {side} its expectation by {abs(misfit_sd):.0f} sd"


def _remedy(convergence: Convergence, carriers: Ints, log: SensingLog, beyond: Ints) -> str:
    """Say what to do about an estimate that is not to be trusted.

    Args:
        convergence: The verdict.
        carriers: Robots that carry most of the misfit, shape (n,).
        log: What was sensed.
        beyond: Robots beyond the reach of their contacts, shape (m,).
    """
    if not convergence.converged and beyond.size:
        return f"look for wrong contacts, heights and spawn positions of {named(log, beyond)}"
    if convergence.chains <= 1:
        return "localize by joint, with several chains"
    if not convergence.converged:
        otherwise = "if that does not help, look for wrong measurements"
        return f"try twice the steps or chains, or another seed; {otherwise}"
    if convergence.misfit_sd < -MOST_MISFIT_SD:
        return "state smaller noise in the log"
    if carriers.size:
        return "look at the measurements of these robots, or leave them out"
    return (
        "look for wrong measurements; if there are none, state larger noise in the log, or correct "
        "its dock_radius and dock_offsets"
    )


def cautions(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """Describe in lines what even an estimate that is trusted leaves ambiguous."""
    torn = _torn(estimate)
    if torn.size:
        yield (
            f"only outliers tie {named(log, torn)} to the anchor (positions are guesses); look at "
            "the contacts and ranges of these robots"
        )
    for text in _mirrored(log, estimate):
        yield (
            f"{text}; configurations that fit put them farther apart than their sd, and their "
            "estimate is the mean of these; measure what would exclude all but one"
        )
    for turn in estimate.turns:
        yield (
            f"free to turn about {_pivot(log, turn)}: {named(log, turn.robots)}; no measurement "
            f"would change, and sd_{log.length_unit} includes all turns; measure ranges to robots "
            "elsewhere, or heights or places"
        )
    for text in _undetermined(estimate):
        yield (
            f"{text}: no measurement resists free motions of these; sd_{log.length_unit} says how "
            "far they may move, and tiswarm advise names measurements that would exclude them"
        )
    if estimate.free_frame:
        motions = " or ".join(_MOTIONS[name] for name in estimate.free_frame)
        text = f"frame arbitrary: no measurement would change if all robots {motions}"
        shape = f"; sd_{log.length_unit} is that of the shape"
        yield text + (shape if estimate.sd is not None else "")


def describe_solutions(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """Describe in lines the solutions that a method found, if there are several."""
    solutions = estimate.solutions
    unit = log.length_unit
    if len(solutions) <= 1:
        return
    chains = sum(solution.chains for solution in solutions)
    for number, solution in enumerate(solutions[:MOST_SHOWN], start=1):
        text = solution_name(estimate, number)
        more = solution.chi_square - solutions[0].chi_square
        if number > 1 and np.isfinite(more):
            text += f", chi-square {more:+.3g}"
        text += f", {solution.chains} of {chains} chains"
        if number > 1:
            away = ~log.is_gone * np.linalg.norm(solution.position - solutions[0].position, axis=1)
            farthest = np.argsort(-away, kind="stable")
            elsewhere = farthest[away[farthest] > log.spacing]
            text += f"; up to {away.max():.3g} {unit} from solution 1"
            text += f": {named(log, elsewhere)}" if elsewhere.size else ""
        yield text
    if len(solutions) > MOST_SHOWN:
        yield counted(len(solutions) - MOST_SHOWN, "more solution")


def solution_name(estimate: Estimate, number: int) -> str:
    """Name a solution, counted from 1, with its weight."""
    solutions = estimate.solutions
    weight = percent(solutions[number - 1].weight)
    return f"solution {number} of {len(solutions)}, weight {weight} %"


def describe_outliers(log: SensingLog, path: Path, estimate: Estimate) -> Iterator[str]:
    """Name each outlier with its line of the log; none where the method looks for none."""
    name = log.robot_id.tolist()
    flips = np.diff(log.earlier.start)
    rows = [*_outlier_pairs(log, estimate), *_outlier_places(log, estimate)]
    for robot, stance, key, what in rows:
        of_robot = key in NUMBERS or stance == flips[robot]
        place = f"{_line(log, path, robot)}: {'' if of_robot else f'stances[{stance}].'}{key}"
        yield f"{place}: robot {name[robot]}'s {what} is an outlier"
    for robot in [] if estimate.outlier_robots is None else estimate.outlier_robots.tolist():
        yield (
            f"{_line(log, path, robot)}: orientation_wxyz: robot {name[robot]}'s orientation is an "
            "outlier: its measurements all disagree; look at its IMU"
        )


def named(log: SensingLog, rows: AnyInts, most: int = MOST_SHOWN) -> str:
    """Count robots, and list the first."""
    names = [str(name) for name in log.robot_id[rows[:most]].tolist()]
    if len(rows) > most:
        names.append("...")
    robots = counted(len(rows), "robot")
    return f"{robots} ({', '.join(names)})" if names else robots


def _line(log: SensingLog, path: Path, robot: int) -> str:
    """Name the file and the line of a robot."""
    return f"{path}:{log.line_of(robot)}"


def _fitting(estimate: Estimate) -> Iterator[str]:
    """Count the configurations that fit, if there are several."""
    solutions = estimate.solutions
    if len(solutions) > 1:
        likeliest = percent(solutions[0].weight)
        yield f"{len(solutions)} configurations fit, the likeliest has {likeliest} %"


def _mirrored(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """Name the robots that are mirrored between solutions, if there are any."""
    if estimate.mirrored is None:
        return
    mirrored = np.flatnonzero(estimate.mirrored & ~log.is_gone)
    if mirrored.size:
        yield f"mirrored: {named(log, mirrored)}"


def _torn(estimate: Estimate) -> Ints:
    """Find the robots that measurements tie to the anchor, but outliers alone.

    Chains cannot bring a part of many robots to where a contact says that is far away.
    """
    observability = estimate.observability
    if observability is None or not _outliers(estimate):
        return np.empty(0, np.int64)
    return np.flatnonzero(estimate.disconnected & ~observability.disconnected)


def _outliers(estimate: Estimate) -> int:
    """Count contacts, ranges and coordinates that are outliers."""
    listed = (estimate.outlier_contacts, estimate.outlier_places)
    return sum(len(rows) for rows in listed if rows is not None)


def _turning(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """Name the robots that are free to turn about others."""
    if estimate.turns:
        robots = np.unique(np.concatenate([turn.robots for turn in estimate.turns]))
        yield f"free to turn: {named(log, robots)}"


def _pivot(log: SensingLog, turn: OpenTurn) -> str:
    """Name the robot, or the line of robots, about which others turn."""
    where = f"robot {log.robot_id[turn.about[0]]}"
    if len(turn.about) > 1:
        return f"the line through {named(log, np.sort(turn.about))}"
    if turn.axis is None:
        return f"every axis through {where}"
    return f"the {'vertical' if abs(turn.axis[2]) > _VERTICAL else 'axis'} through {where}"


def says_open(estimate: Estimate) -> bool:
    """Whether the verdict says that measurements leave open where most robots are."""
    return any(_undetermined(estimate))


def _undetermined(estimate: Estimate) -> Iterator[str]:
    """State that measurements leave open where more than half of the robots are."""
    observability = estimate.observability
    is_open = estimate.is_open
    if observability is None or is_open is None:
        return
    tied = int((~observability.disconnected).sum())
    if is_open.sum() > _MOSTLY * (tied - 1):
        yield f"measurements do not determine where {is_open.sum()} of {tied} robots are"


def _carriers(estimate: Estimate) -> Ints:
    """Find the few robots that carry most of the chi-square; empty if it is spread over many."""
    if estimate.misfit is None:
        return np.empty(0, np.int64)
    order = np.argsort(-estimate.misfit, kind="stable")
    share = np.cumsum(estimate.misfit[order])
    count = int((share <= 0.5 * share[-1]).sum()) + 1
    few = count <= min(MOST_SHOWN, _FEW * len(order))
    return order[: count if few else 0]


def _beyond_reach(log: SensingLog, estimate: Estimate) -> Ints:
    """Find robots where no chain of their contacts ends."""
    rows = measure(log, ["contacts"])
    arms = np.linalg.norm([rows.arm, rows.neighbor_arm], axis=2).sum(axis=0)
    part = connected_parts(rows)
    bound = reach(np.column_stack([rows.robot, rows.neighbor]), SPACING + arms, part)
    first = np.unique(part, return_index=True)[1][part]
    away = np.linalg.norm(estimate.position - estimate.position[first], axis=1)
    return np.flatnonzero(away > _STRETCH * bound * log.dock_radius)


_Outlier = tuple[int, int, str, str]
"""Robot, its stance, the key of the log, and what it is."""


def _outlier_pairs(log: SensingLog, estimate: Estimate) -> Iterator[_Outlier]:
    """Describe the outliers among measurements of two robots."""
    if estimate.outlier_contacts is None:
        return
    name = log.robot_id.tolist()
    measured = Measured(log)
    # Of cues with equal rows the last one counts: a displacement also says how far robots are.
    pairs = {
        cue: set(map(tuple, measured.rows([cue.name]).sensed_contacts.tolist()))
        for cue in reversed(CUES)
    }
    for row in estimate.outlier_contacts.tolist():
        robot, stance, dock, neighbor, neighbor_dock = row
        cue = next(cue for cue, rows in pairs.items() if tuple(row) in rows or cue is CUES[0])
        item = cue.item.format(dock=dock, neighbor=name[neighbor], neighbor_dock=neighbor_dock)
        yield robot, stance, cue.key, item


def _outlier_places(log: SensingLog, estimate: Estimate) -> Iterator[_Outlier]:
    """Of all coordinates of a point that are outliers, the estimate misses these the most."""
    places = estimate.outlier_places
    if places is None or not len(places):
        return
    measured = Measured(log)
    center = estimate.position / log.dock_radius
    wanted, number = np.unique(places, axis=0, return_counts=True)
    listed: dict[tuple[int, ...], list[tuple[float, str, str]]] = {}
    for cue in CUES:
        rows = measured.rows([cue.name, WALKED] if cue.walked else [cue.name])
        count = len(rows.neighbor)
        missed = np.abs(rows.residual(center, estimate.yaw)) / np.sqrt(rows.variance())
        for point, axis, value, off in zip(
            rows.sensed_places.tolist(), rows.places.direction, rows.places.value,
            missed[count:].tolist(), strict=True,
        ):  # fmt: skip
            text = cue.item.format(
                dock=point[2],
                along=_axis(axis),
                at=f"{value * log.dock_radius:.4g} {log.length_unit}",
            )
            listed.setdefault(tuple(point), []).append((-off, cue.key, text))
    for point, many in zip(wanted.tolist(), number.tolist(), strict=True):
        for _, key, text in sorted(listed.get(tuple(point), []))[:many]:
            yield point[0], point[1], key, text


def _axis(direction: Reals) -> str:
    """Write a unit vector, an axis by its letter."""
    along = np.flatnonzero(direction == 1.0)
    return "xyz"[along[0]] if along.size else f"[{', '.join(f'{part:.3g}' for part in direction)}]"
