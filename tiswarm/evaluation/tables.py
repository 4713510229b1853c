"""Tables of a case: scores of its estimate, errors by robot and iteration, growth by join.

A case that was not localized has those of its structure alone.
"""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.plugins import call_plugin
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation import metrics
from tiswarm.evaluation.metrics import by_hops_apart
from tiswarm.measurements import contacts
from tiswarm.measurements.cues import Measured
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.observability import hops_from_anchors
from tiswarm.measurements.odometry import with_orientations
from tiswarm.measurements.rigidity import weld
from tiswarm.records.error_law import SURE
from tiswarm.records.estimate import HALF_WITHIN, MOST_WITHIN, Estimate
from tiswarm.records.frames import GREATEST
from tiswarm.records.measures import (
    BROKEN,
    MARGIN,
    SLID,
    STANDING,
    TIPPED,
    PluginMeasure,
    plugin_measures,
)
from tiswarm.records.positions import Truth, read_length_unit, read_positions
from tiswarm.records.sensing_log import SensingLog
from tiswarm.world.climb_kernels import GROUND
from tiswarm.world.history import History, Walk
from tiswarm.world.strength import WEIGHTS, StrengthParams

LOSSES = ("left", "fell", "died")
"""Names of what happened to a robot, in the order of `history.departures`."""

CROWD = 20.0
"""Height above the ground up to which robots count as the crowd at a tower's foot [R]."""

DOCK_DIAMETER = 2.0
"""The accuracy that the paper calls sufficient for attachment [R]."""


def of_structure(truth: Truth, log: SensingLog) -> dict[str, float | int]:
    """Return how many robots joined, how many touch each other, and how far they extend.

    Robots that left do not count in the last two.
    """
    stays = ~log.is_gone
    unknown = np.isnan(log.known_position[:, 0]) & stays
    return {
        "joined": log.robot_count,
        "contacts_per_robot": _mean(metrics.earlier_contact_count(log)[unknown]),
        "rms_radius_R": metrics.rms_radius(truth.position[stays]),
    }


def score(
    truth: Truth, log: SensingLog, estimate: Estimate, robot: RobotGeometry, *, rows: Measurements
) -> dict[str, float | int]:
    """Return accuracy measures of an estimate, and properties of the structure that limit them.

    Robots that left are not scored. `rows` are those of the log that the localizer used; `robot` is
    for lengths in rho.
    """
    stays = ~log.is_gone
    estimated = estimate.position[stays]
    true = truth.position[stays]
    rmse = metrics.rmse(estimated, true)
    pairs = log.contacts[:, [0, 2]]
    pairs = pairs[stays[pairs].all(axis=1)]
    of_contacts = metrics.relative_errors(estimate.position, truth.position, pairs)
    unknown = np.isnan(log.known_position[:, 0]) & stays
    error = metrics.robot_errors(estimate.position, truth.position)[unknown]
    position = truth.position / log.dock_radius
    modes = weld(rows, position, yaw_unknown=estimate.yaw is not None).floppy_modes
    at_join = {}
    if estimate.at_join is not None:
        at_join = {"rmse_at_join_R": metrics.rmse(estimate.at_join, truth.position)}
    steps = {}
    if estimate.steps is not None:
        steps = {"steps_per_robot": _mean(estimate.steps[unknown])}
    return {
        **of_structure(truth, log),
        "floppy_modes": np.nan if modes is None else modes,
        "disconnected": int(estimate.disconnected[stays].sum()),
        "sse_R2": metrics.sse(estimated, true),
        "rmse_R": rmse,
        "rmse_rho": rmse / robot.dock_distance,
        "rmse_yaw_aligned_R": metrics.rmse(metrics.yaw_aligned(estimated, true), true),
        "rmse_rigid_aligned_R": metrics.rmse(metrics.rigidly_aligned(estimated, true), true),
        "rmse_per_contact_R": _mean(of_contacts**2) ** 0.5,
        "within_dock": _mean(error <= DOCK_DIAMETER),
        "contacts_within_dock": _mean(of_contacts <= DOCK_DIAMETER),
        "procrustes_disparity": metrics.procrustes_disparity(estimated, true),
        **at_join,
        **steps,
        **_of_located(truth, estimate, unknown),
        **_calibration(truth, estimate, unknown),
        **_of_traffic(estimate),
    }


def outlier_scores(
    history: History, estimate: Estimate, *, rows: Measurements
) -> dict[str, float | int]:
    """Return precision and recall of the detected outliers, and the counts behind them.

    A contact is wrong if the robots did not touch with these docks in that stance. Touches, whose
    docks are unknown, are not scored. `rows` are those of the log that the localizer used.

    Returns:
        Scores by name; NaN where no contact is wrong or detected; empty where the method detects
        no outliers.
    """
    if estimate.outlier_contacts is None:
        return {}
    sensed = _with_docks(rows.sensed_contacts)
    true = history.table("contacts")
    size = tuple(np.concatenate([true, sensed]).max(axis=0, initial=0) + 1)

    def key(contacts: AnyInts) -> Ints:  # each row as one number
        return np.asarray(np.ravel_multi_index(tuple(contacts.astype(np.int64).T), size))

    outliers = key(_with_docks(estimate.outlier_contacts))
    wrong = np.setdiff1d(key(sensed), key(true))
    hits = np.isin(outliers, wrong).sum()
    return {
        "wrong_contacts": len(wrong),
        "outliers": len(outliers),
        "outlier_precision": hits / len(outliers) if len(outliers) else np.nan,
        "outlier_recall": hits / len(wrong) if len(wrong) else np.nan,
    }


def _with_docks(contacts: Ints) -> Ints:
    """Choose the rows of contacts, (n, 5), that name both docks: neither ranges nor touches."""
    return contacts[(contacts[:, [2, 4]] >= 0).all(axis=1)]


def by_robot(
    truth: Truth, log: SensingLog, estimate: Estimate | None, history: History
) -> pd.DataFrame:
    """Tabulate each robot in join order: true and estimated pose, errors, contacts and load.

    Robots that left have no errors. `sensed_force` is what each robot senses in its links [weight
    of a dock].
    """
    table = pd.DataFrame({"robot": truth.robot_id})
    table[["x_R", "y_R", "z_R"]] = truth.position
    table[["qw", "qx", "qy", "qz"]] = truth.orientation_wxyz
    error = pd.DataFrame()
    disconnected = {}
    if estimate is not None:
        table = pd.concat([table, _estimated(truth, log, estimate)], axis=1)
        error = _errors(truth, log, estimate)
        disconnected = {"disconnected": estimate.disconnected}
    if len(history.departures):
        robot, after, event = history.departures.T
        table["lost"] = pd.Series(np.array(LOSSES)[event], robot)
        table["lost_after"] = pd.Series(after, robot).astype("Int64")
        table["lost_round"] = pd.Series(history.leave_round[robot], robot).astype("Int64")
    if len(history.sent):
        table["rule_sent_B"] = history.sent
    apart = pd.Series(hops_from_anchors(log))
    return table.assign(
        **error,
        contacts=contacts.contact_count(log),
        hops_from_anchor=apart.replace(np.inf, np.nan).astype("Int64"),
        ground_docks=np.bincount(log.ground_docks[:, 0], minlength=log.robot_count),
        flip_height_R=log.flip_height,
        **disconnected,
        sensed_force=history.sensed,
        **({"margin": _in_a_table(history.margin)} if history.breaks else {}),
    )


GROUND_WORD = "ground"
"""Neighbor of a dock on the ground, in tables of loads."""


def by_contact(history: History, strength: StrengthParams | None) -> pd.DataFrame:
    """Tabulate the loads of each contact at rest, from the weakest contact on.

    The robot of a row joined after its neighbor; its dock may also stand on the ground. Columns
    name the units, those of `strength`: W is the weight of a dock. There are no rows where the
    mechanics were not solved after the last join.
    """
    docks = history.robot.dock_count
    units = WEIGHTS if strength is None else strength.units_for(docks)
    earlier, earlier_dock, later, later_dock = history.loaded_contacts.T
    stands = later < 0
    neighbor = pd.Series(np.where(stands, -1, earlier)).astype(str)
    neighbor_dock = pd.Series(earlier_dock, dtype="Int64")
    table = pd.DataFrame(
        {
            "robot": np.where(stands, earlier, later),
            "dock": np.where(stands, earlier_dock, later_dock),
            "neighbor": neighbor.mask(stands, GROUND_WORD),
            "neighbor_dock": neighbor_dock.mask(stands),
        }
    )
    *loads, used = history.contact_load.T
    for (load, unit), values in zip(units.of_loads.items(), loads, strict=True):
        table[f"{load}_{unit.suffix}"] = unit.size * values
    with np.errstate(divide="ignore"):  # a contact without load has any margin
        table["margin"] = _in_a_table(1.0 / used)
    return table.sort_values("margin", kind="stable", ignore_index=True)


def _in_a_table(margin: Reals) -> Reals:
    """Return margins [1], NaN of contacts without load, whose margins no table can hold."""
    return np.where(margin <= GREATEST, margin, np.nan)


def _estimated(truth: Truth, log: SensingLog, estimate: Estimate) -> pd.DataFrame:
    """Tabulate the estimated pose of each robot, and what it found out while it joined."""
    table = pd.DataFrame(index=range(len(truth.robot_id)))
    table[["x_est_R", "y_est_R", "z_est_R"]] = estimate.position
    sensed = with_orientations(log).orientation_wxyz
    table[["qw_sensed", "qx_sensed", "qy_sensed", "qz_sensed"]] = sensed
    if estimate.at_join is not None:
        table["error_at_join_R"] = metrics.robot_errors(estimate.at_join, truth.position)
    if estimate.doubtful is not None:
        table["doubtful"] = estimate.doubtful
    if estimate.traffic is not None:
        table["sent_B"] = estimate.traffic["sent"]
        table["heard_B"] = estimate.traffic["heard"]
    return table


def _errors(truth: Truth, log: SensingLog, estimate: Estimate) -> pd.DataFrame:
    """Tabulate the errors of the robots that stay, by their index."""
    stays = ~log.is_gone
    true = truth.position[stays]
    estimated = estimate.position[stays]
    error = pd.DataFrame(index=np.flatnonzero(stays))
    error["error_R"] = metrics.robot_errors(estimated, true)
    for name, aligned in (("yaw", metrics.yaw_aligned), ("rigid", metrics.rigidly_aligned)):
        error[f"error_{name}_aligned_R"] = metrics.robot_errors(aligned(estimated, true), true)
    return error


def by_iteration(truth: Truth, log: SensingLog, estimate: Estimate) -> pd.DataFrame:
    """Tabulate each recorded iteration: errors, and the residual of the localizer."""
    table = pd.DataFrame({"iteration": estimate.iteration})
    true = truth.position[~log.is_gone]
    trace = estimate.trace[:, ~log.is_gone]
    table["sse_R2"] = [metrics.sse(frame, true) for frame in trace]
    table["rmse_R"] = [metrics.rmse(frame, true) for frame in trace]
    table["procrustes_disparity"] = [metrics.procrustes_disparity(frame, true) for frame in trace]
    return table.assign(residual_R=estimate.residual)


def by_join(history: History) -> pd.DataFrame:
    """Tabulate the growth of a structure: its size and load after each join.

    Mechanics are missing where the structure was not solved after the join.
    """
    walks = history.walks
    loads = history.loads
    terrain = history.terrain
    x, _, z = history.position.T
    joined = np.arange(1, len(walks) + 1)
    standing = np.concatenate([history.table("ground_docks"), history.table("edge_docks")])
    last = np.array([walk.stance_count - 1 for walk in walks])
    standing = standing[standing[:, 1] == last[standing[:, 0]], 0]
    sent = [walk.belief[3] for walk in walks if len(walk.belief)]
    sent_bytes = {"sent_B": sent} if np.isfinite(sent).any() else {}
    overhang: Reals | float = np.nan
    if terrain.has_edge:
        overhang = _standing(x, history, np.mean) - terrain.left_edge
    return pd.DataFrame(
        {
            "robots": joined,
            "height_R": _standing(z, history, np.max) - history.ground_z,
            "depth_R": history.ground_z + _standing(-z, history, np.max),
            "reach_R": _standing(x, history, np.max),
            "peak_stress": [s.peak for s in loads],
            "sensed_max": [s.sensed_max for s in loads],
            "calling": [s.calling for s in loads],
            "recruited": np.cumsum([walk.recruited for walk in walks]),
            "flips": [walk.stance_count - 1 for walk in walks],
            "round": [walk.round for walk in walks],
            "contacts": np.bincount(history.contacts_at_join[:, 2], minlength=len(walks)),
            "ground_docks": np.bincount(standing, minlength=len(walks)),
            "on_anchor": np.cumsum(np.isin(joined - 1, _on_anchor(history))),
            "anchored": _anchored(history),
            "least_support": [s.least_support for s in loads],
            "overhang_R": overhang,
            **_losses(history),
            **_breaks(history),
            **sent_bytes,
        }
    )


def _losses(history: History) -> dict[str, Ints]:
    """Count who had left, fallen and died by each join; empty where all must stay."""
    if not (history.may_lose or len(history.departures) or history.breaks):
        return {}
    _, after, event = history.departures.T
    joined = np.arange(1, history.robot_count + 1)
    return {
        name: np.searchsorted(after[event == k], joined, "right") for k, name in enumerate(LOSSES)
    }


def _breaks(history: History) -> dict[str, Ints]:
    """Count the contacts that had broken by each join; empty where docks hold any load."""
    if not history.breaks:
        return {}
    joined = np.arange(1, history.robot_count + 1)
    return {BROKEN.column: np.searchsorted(history.broken[:, 4], joined, "right")}


def _standing(x: Reals, history: History, statistic: Callable[[Reals], float]) -> Reals:
    """Compute the maximum or mean of x over the robots that stand after each join, shape (N,)."""
    joined = np.arange(1, len(x) + 1)
    if history.is_gone.any():
        departure = history.left_after
        return np.array([statistic(x[:n][departure[:n] > n]) for n in joined.tolist()])
    if statistic is np.mean:  # all robots remain, which needs no loop
        mean: Reals = np.cumsum(x) / joined
        return mean
    return np.maximum.accumulate(x)


def _anchored(history: History) -> list[int]:
    """Count the robots that contacts tie to an anchor after each join; all if some have left."""
    components = DisjointSet([*range(history.robot_count)])
    anchored = []
    for j, walk in enumerate(history.walks):
        for i in walk.at_rest(walk.contacts)[:, 1]:
            components.merge(int(i), j)
        tied = {components[i] for i in range(min(history.anchors, j + 1))}
        anchored.append(sum(map(components.subset_size, tied)))
    return anchored


def totals(history: History) -> dict[str, float | int]:
    """Return the size and load of a finished structure."""
    grown = by_join(history)
    names = ("height_R", "reach_R", "depth_R", "peak_stress", "sensed_max", "recruited")
    terrain = history.terrain
    x, _, z = (history.position[~history.is_gone] - [0.0, 0.0, history.ground_z]).T
    is_beyond = (x > terrain.left_edge) & (x < terrain.right_edge)
    first, second, third, *_ = [*map(int, _on_anchor(history)), np.nan, np.nan, np.nan]
    return {
        **{name: grown[name].tolist()[-1] for name in names},
        "spawns": history.spawns,
        **({name: grown[name].iloc[-1] for name in (*LOSSES, BROKEN.column) if name in grown}),
        **_strength(history),
        **_stability(history),
        "crossed": int(history.crossed),
        "beyond_edge": float(is_beyond.mean()) if terrain.has_edge else np.nan,
        "above_crowd": float((z > CROWD).mean()) if terrain.is_plane else np.nan,
        **_flips(history),
        **_beliefs(history),
        **_messages(history),
        "first_on_anchor": first,
        "second_on_anchor": second,
        "third_on_anchor": third,
    }


def _strength(history: History) -> dict[str, float]:
    """Return who stands, and the least margin of a robot; empty where docks hold any load."""
    if not history.breaks:
        return {}
    margin = _in_a_table(history.margin)
    least = np.nan if np.isnan(margin).all() else float(np.nanmin(margin))
    return {STANDING.column: int(np.count_nonzero(~history.is_gone)), MARGIN.column: least}


def _stability(history: History) -> dict[str, int]:
    """Return whether a structure tipped or slid; empty where the ground holds docks."""
    if not history.stability:
        return {}
    return {measure.column: int(history.stability == measure.column) for measure in (TIPPED, SLID)}


def _flips(history: History) -> dict[str, float]:
    """Return the tries of a robot, the share that ended as planned, and those that failed.

    The way back counts in the first alone; the others are NaN where robots know the truth.
    """
    failed = sum(int(walk.failed_flips.sum()) for walk in history.walks)
    taken = sum(len(walk.planned_robot) for walk in history.walks)
    swings = sum(len(walk.pivot_dock) for walk in history.walks)
    as_planned = sum(map(_as_planned, history.walks))
    return {
        "flips_as_planned": as_planned / (taken + failed) if taken else np.nan,
        "failed_flips": failed / taken if taken else np.nan,
        "tries_per_robot": (swings + failed) / history.robot_count,
    }


def _as_planned(walk: Walk) -> int:
    """Count the flips that led a dock other than the pivot to the robot, or ground, as planned."""
    feet = np.concatenate([walk.ground_docks, walk.edge_docks])
    met = np.concatenate([walk.contacts[:, :3], np.insert(feet, 2, GROUND, axis=1)])
    met = met[(met[:, 0] > 0) & (met[:, 0] <= len(walk.planned_robot))]
    met = met[met[:, 1] != walk.pivot_dock[met[:, 0] - 1]]
    planned = enumerate(walk.planned_robot.tolist(), start=1)
    return len({*map(tuple, met[:, ::2].tolist())} & {*planned})


def _beliefs(history: History) -> dict[str, float]:
    """Return errors and bytes of places that robots believed; empty where they know the truth."""
    beliefs = np.array([walk.belief for walk in history.walks if len(walk.belief)])
    if not len(beliefs):
        return {}
    building, newest, *_ = np.sqrt((beliefs**2).mean(axis=0))
    return {
        "belief_building_R": building,
        "belief_newest_R": newest,
        "belief_final_R": beliefs[-1, 0],
        "belief_per_contact_R": beliefs[-1, 2],
        "belief_sent_B": beliefs[-1, 3],
        "belief_worst_sent_B": beliefs[-1, 4],
    }


def _messages(history: History) -> dict[str, float]:
    """Return the bytes of the messages of the rule of growth; empty where it has none."""
    if not len(history.sent):
        return {}
    return {"rule_sent_B": _mean(history.sent), "worst_rule_sent_B": int(history.sent.max())}


def _on_anchor(history: History) -> NDArray[np.int32]:
    """List the robots that touch an anchor, in join order."""
    contacts = history.contacts_at_join
    touching: NDArray[np.int32] = np.unique(contacts[contacts[:, 0] < history.anchors, 2])
    return touching


class Scores(dict[str, float]):
    """Accuracy measures by name, in the length unit of the truth, of the robots that remain."""

    def __init__(self, true: Reals, estimated: Reals, is_gone: Bools, unit: str) -> None:
        """Compare true and estimated centers [unit], both of shape (N, 3).

        Robots that left, `is_gone` of shape (N,), do not count: the scores have their number as
        `left`, and `true` and `estimated` are of the others.
        """
        true = true[~is_gone]
        estimated = estimated[~is_gone]
        self.unit = unit
        self.left = int(is_gone.sum())
        self.true = true
        self.estimated = estimated
        yaw_aligned = metrics.yaw_aligned(estimated, true)
        rigidly_aligned = metrics.rigidly_aligned(estimated, true)
        super().__init__(
            {
                "RMSE": metrics.rmse(estimated, true),
                "RMSE, yaw and place aligned": metrics.rmse(yaw_aligned, true),
                "RMSE, rigidly aligned": metrics.rmse(rigidly_aligned, true),
                "largest error": float(metrics.robot_errors(estimated, true).max()),
                "rms radius of the structure": metrics.rms_radius(true),
                "Procrustes disparity": metrics.procrustes_disparity(estimated, true),
            }
        )

    @property
    def errors(self) -> dict[str, Reals]:
        """Errors of the robots in the order of the estimate [unit], each of shape (N,)."""
        aligned = metrics.yaw_aligned(self.estimated, self.true)
        return {
            "as it is": metrics.robot_errors(self.estimated, self.true),
            "yaw and place aligned": metrics.robot_errors(aligned, self.true),
        }

    def __str__(self) -> str:
        """Give a line for each measure."""
        lines = []
        for name, value in self.items():
            unit = "" if "disparity" in name else f" {self.unit}"
            lines.append(f"{name:<28} {value:.4g}{unit}")
        if self.left:
            lines.append(f"{'robots that left, not scored':<28} {self.left}")
        return "\n".join(lines)


def score_files(truth: Path, estimate: Path | Estimate) -> Scores:
    """Compare a table of true positions with an estimate or its table, matching robots by name.

    Robots that left do not count.

    Raises:
        InputError: if a table is malformed, the estimate has another unit or other robots, or the
            truth has an sd that the estimate lacks, as where the two are exchanged.
    """
    unit = read_length_unit(truth)
    names, true, columns_of_truth = read_positions(truth, unit)
    further: Mapping[str, object]
    path = None
    if isinstance(estimate, Path):
        path = estimate
        estimated_names, estimated, further = read_positions(estimate, unit)
        sd = f"sd_{unit}"
        if sd in columns_of_truth and sd not in further:
            problem = f"{sd} is a column of an estimate; give the table of true positions first"
            raise InputError(problem, path=truth, line=1)
    else:
        estimated_names = estimate.robot_id
        estimated = estimate.position
        further = estimate.columns()
        if estimate.length_unit != unit:
            problem = f"is in {estimate.length_unit}, the truth in {unit}; use the same unit"
            raise InputError(problem, argument="estimate")
    missing = np.setxor1d(names, estimated_names)
    if len(missing):
        problem = f"robot {missing[0]} is in one of the two tables only; score the same robots"
        raise InputError(problem, path=path, key="robot")
    is_gone = np.broadcast_to(np.asarray(further.get("gone", "no")) == "yes", len(true))
    in_order_of_estimate = names.argsort()[estimated_names.argsort().argsort()]
    return Scores(true[in_order_of_estimate], estimated, is_gone, unit)


def _of_located(truth: Truth, estimate: Estimate, unknown: Bools) -> dict[str, float]:
    """Return the share of robots located, and their RMSE; both without anchors."""
    located = ~estimate.is_guess[unknown]
    square = metrics.robot_errors(estimate.position, truth.position)[unknown][located] ** 2
    return {"located": _mean(located), "rmse_located_R": _mean(square) ** 0.5}


def _of_traffic(estimate: Estimate) -> dict[str, float | int]:
    """Return what robots sent each other and held, in the mean and at worst; and the doubtful."""
    scores: dict[str, float | int] = {}
    if estimate.doubtful is not None:
        scores["doubtful"] = int(estimate.doubtful.sum())
    traffic = estimate.traffic
    if traffic is not None:
        for name in ("sent", "heard", "memory"):
            count = traffic[name]
            scores |= {f"{name}_B": _mean(count), f"worst_{name}_B": int(count.max())}
        scores |= {name: _mean(traffic[name]) for name in ("messages", "rounds", "operations")}
        scores |= {"worst_operations": float(traffic["operations"].max())}
        joins = traffic.get("joins")
        if joins is not None:
            scores |= {"solved_share": float(joins.max() / max(joins.sum(), 1.0))}
    return scores


def _calibration(truth: Truth, estimate: Estimate, unknown: Bools) -> dict[str, float | int]:
    """Return the shares of robots in their intervals, without anchors, and the verdicts."""
    scores: dict[str, float | int] = {}
    if estimate.sd is not None:
        error = metrics.robot_errors(estimate.position, truth.position)[unknown]
        sd = estimate.sd[unknown]
        scores["expected_rmse_R"] = estimate.expected_rmse(unknown)
        scores["coverage_50"] = _mean(error <= HALF_WITHIN * sd)
        scores["coverage_90"] = _mean(error <= MOST_WITHIN * sd)
        scores |= _of_sure(estimate, error, unknown)
    convergence = estimate.convergence
    if convergence is not None:
        scores["converged"] = convergence.converged
        if convergence.consistent is not None:
            scores["consistent"] = convergence.consistent
        scores |= {"testable": convergence.testable, "misfit_sd": convergence.misfit_sd}
        if convergence.spare is not None:
            scores["spare_measurements"] = convergence.spare
        scores["sd_factor"] = convergence.sd_factor
        scores |= {"chains": convergence.chains, "restarted_chains": convergence.restarted}
    if estimate.is_open is not None:
        scores["open_robots"] = int(estimate.is_open[unknown].sum())
    if estimate.mirrored is not None:
        scores["mirrored"] = int(estimate.mirrored[unknown].sum())
    if convergence is not None:
        suspects = estimate.outlier_robots
        scores["suspects"] = 0 if suspects is None else len(suspects)
    return scores


def _of_sure(estimate: Estimate, error: Reals, unknown: Bools) -> dict[str, float]:
    """Return the share of robots that are surely within R, and how many of these are not.

    Args:
        estimate: The estimate [R].
        error: Errors of robots whose positions were unknown [R], shape (n,).
        unknown: Which robots these are, shape (N,).
    """
    probability = estimate.within(1.0)
    if probability is None:
        return {}
    is_sure = probability[unknown] >= SURE
    scores = {"sure_1R": _mean(is_sure)}
    if is_sure.any():
        scores["sure_off_1R"] = _mean(error[is_sure] >= 1.0)
    return scores


def _mean(values: NDArray[np.generic]) -> float:
    """Return the mean; NaN without values."""
    return float(values.mean()) if values.size else float("nan")


def plugin_scores(part: Callable[[str], object]) -> dict[str, float]:
    """Return the measures of plug-ins by name.

    Args:
        part: Returns a part of the case, one of `records.measures.PARTS`; None where it has none.

    Raises:
        PluginError: a function failed, or returned something else than a number.
    """
    return {name: _score_of(measure, part) for name, measure in plugin_measures().items()}


def _score_of(measure: PluginMeasure, part: Callable[[str], object]) -> float:
    if measure.needs_estimate and part("estimate") is None:
        return float("nan")
    parts = {name: part(name) for name in measure.asks}

    def compute() -> tuple[object, NDArray[Any]]:
        value = measure.call(parts)
        return value, np.asarray(value)

    _, number = call_plugin(
        "measure", measure.column, compute, lambda returned: _fault_of_score(*returned)
    )
    return float(number)


def _fault_of_score(value: object, number: NDArray[Any]) -> str:
    if number.ndim == 0 and number.dtype.kind in "biuf" and not np.isinf(number):
        return ""
    return f"{value!r:.60}; return a number, or NaN"


class Evaluation(NamedTuple):
    """A structure, and an estimate of it against the truth: scores and tables, each by name."""

    truth: Truth
    scores: Mapping[str, float | int]
    measurements: str
    """Cues that the method used and the log has."""

    tables: Mapping[str, pd.DataFrame]


def evaluate(
    history: History,
    log: SensingLog,
    estimate: Estimate | None,
    cues: Collection[str],
    strength: StrengthParams | None = None,
) -> Evaluation:
    """Compare the estimate of a log, localized by these cues, with the structure it is of.

    Without an estimate, the structure is measured. Where docks have a strength, there is a table of
    the loads of their contacts.
    """
    truth = Truth(
        robot_id=log.robot_id, position=history.position, orientation_wxyz=history.orientation_wxyz
    )
    tables = {"robots": by_robot(truth, log, estimate, history), "growth": by_join(history)}
    if strength is not None:
        tables["loads"] = by_contact(history, strength)
    if estimate is None:
        return Evaluation(
            truth=truth,
            scores=of_structure(truth, log) | totals(history),
            measurements="",
            tables=tables,
        )
    measured = Measured(log)
    rows = measured.rows(cues)
    scores = score(truth, log, estimate, history.robot, rows=rows)
    scores |= outlier_scores(history, estimate, rows=rows) | totals(history)
    tables["convergence"] = by_iteration(truth, log, estimate)
    tables["relative"] = by_hops_apart(truth, log, estimate)
    return Evaluation(
        truth=truth,
        scores=scores,
        measurements=", ".join(measured.used(cues)),
        tables=tables,
    )
