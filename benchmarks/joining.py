"""Measures what robots know as they join, and what it costs them.

    python -m benchmarks.joining                                  # 25 towers, 25 cantilevers
    python -m benchmarks.joining --kinds tower --robots 1000 --seeds 1 --at 1000
    python -m benchmarks.joining --messages --seeds 16 --first-seed 100010
    python -m benchmarks.joining --messages --kinds bridge --robots 60 --seeds 64 --reviews 1

Each structure of noisy robots (1 deg tilt, 2 deg yaw) is fed to a `Tracker` robot by robot, on one
thread. `joint` has the whole log, and the logs of the first robots, of each number in `--at`: of
these, errors of the robot that joined last are compared. Times are those of the processor.
Structures that are in the table already are not measured again.

With `--messages`, robots localize themselves by `distributed` instead. The table has their errors
and bytes after 0 to `--reviews` reviews, the errors of `joint` and of the nearest minimum of all
rows, the shares of what they send by kind of message, and how many robots are off by more than R or
doubt where they are. A bridge that does not close is left out, and takes no part in `--seeds`.
"""

import argparse
import itertools
import json
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.distributed.channel import ACKNOWLEDGMENT, Channel
from tiswarm.localization.distributed.method import PeerSwarm
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.methods import centered, localize
from tiswarm.localization.mixture.ends import Posed
from tiswarm.localization.online.tracker import Tracker
from tiswarm.localization.settings import JointParams
from tiswarm.records.estimate import MOST_WITHIN
from tiswarm.records.intervals import mean_std_ci95
from tiswarm.records.sensing_file import SensingLogBuilder, lines_of, log_entries
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import BridgeParams, CantileverParams, TowerParams

KINDS = {"tower": TowerParams(), "cantilever": CantileverParams(), "bridge": BridgeParams()}
NOISY = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0)
WARM_UP = 12
"""Robots of the structure that kernels are compiled for."""


def main() -> None:
    """Measure, store and print a table."""
    options = _options()
    backend.start(threads=1)
    file = options.out / ("messages.csv" if options.messages else "joining.csv")
    options.out.mkdir(parents=True, exist_ok=True)
    table = pd.read_csv(file) if file.exists() else pd.DataFrame({"kind": [], "seed": []})
    _tracked(observe(_grown("tower", WARM_UP, options.first_seed), NOISY))
    for kind in options.kinds:
        for history, seed in _structures(kind, options.robots, options.first_seed, options.seeds):
            sizes = table.get("robots", pd.Series(dtype=float))
            is_there = (table["kind"] == kind) & (table["seed"] == seed)
            if (sizes[is_there] == history.robot_count).any():
                continue
            if options.messages:
                params = DistributedParams(hops=options.hops)
                found = by_messages(history, params, options.reviews)
            else:
                found = measure(history, options.at)
            row = pd.DataFrame([{"kind": kind, "seed": seed, **found}])
            table = pd.concat([table, row], ignore_index=True) if len(table) else row
            table.to_csv(file, index=False, float_format="%.5g")
    # As it is stored, so that a second call prints the same.
    stored = pd.read_csv(file)
    printed = summary_of_messages(stored) if options.messages else summary(stored)
    print(printed.to_string(float_format="{:.3g}".format))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["tower", "cantilever"])
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=25, help="structures of each kind")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--at", type=int, nargs="+", default=[20, 40, 60, 80, 100], metavar="N",
                        help="numbers of robots at which joint has the same log")  # fmt: skip
    parser.add_argument("--messages", action="store_true", help="robots localize themselves")
    defaults = DistributedParams()
    parser.add_argument("--reviews", type=int, default=defaults.reviews, metavar="N",
                        help="times that they solve again")  # fmt: skip
    parser.add_argument("--hops", type=int, default=defaults.hops, metavar="N",
                        help="steps within which they ask others; give another --out")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("reports/joining"))
    return parser.parse_args()


def _structures(
    kind: str, robots: int, first_seed: int, count: int
) -> Iterator[tuple[History, int]]:
    """Grow structures, each with its seed; of bridges those that close."""
    grown = 0
    for seed in itertools.count(first_seed):
        if grown == count:
            return
        history = _grown(kind, robots, seed)
        if kind != "bridge" or history.crossed:
            grown += 1
            yield history, seed


def _grown(kind: str, robots: int, seed: int) -> History:
    [history] = grow(KINDS[kind], robots=robots, seeds=[seed], robot=RobotGeometry())
    return history


def measure(history: History, at: list[int]) -> dict[str, float]:
    """Track the robots of a structure, and localize it by `joint` at some sizes; errors in R."""
    log = observe(history, NOISY)
    true = history.position[: log.robot_count]
    tracker, at_join, at_join_sd, cpu_ms, annealed = _tracked(log)
    final = tracker.estimate(final=True)
    off = np.linalg.norm(at_join - true, axis=1)
    off_after = np.linalg.norm(tracker.positions - true, axis=1)
    numbers = [n for n in at if n <= log.robot_count]
    # The whole log is measured anyway.
    others = {n: _by_joint(log, n) - true[:n] for n in {*numbers, log.robot_count}}
    last = [float(np.linalg.norm(others[n][-1])) for n in numbers]
    local = cpu_ms[~annealed]
    return {
        "robots": log.robot_count,
        "at_join_R": _rms(off),
        "after_R": _rms(off_after),
        "final_R": _rms(np.linalg.norm(final.position - true, axis=1)),
        "joint_R": _rms(np.linalg.norm(others[log.robot_count], axis=1)),
        "last_R": _rms(off[[n - 1 for n in numbers]]),
        "last_joint_R": _rms(np.array(last)),
        "within_at_join": float((off[1:] <= MOST_WITHIN * at_join_sd[1:]).mean()),
        "within_after": float((off_after[1:] <= MOST_WITHIN * tracker.sd[1:]).mean()),
        "local_ms": float(local.mean()),
        "join_ms": float(cpu_ms.mean()),
        "worst_ms": float(cpu_ms.max()),
        "annealed": int(annealed.sum()),
    }


class _Counting(Channel):
    """A channel that counts bytes by kind of message, and those that robots pass on."""

    counted: Counter[str]
    passed: Counter[int]

    def _heard(
        self, hops: Sequence[Any], reached: Sequence[Sequence[int]], sizes: Sequence[int]
    ) -> list[list[int]]:
        for hop, size in zip(hops, sizes, strict=False):  # acknowledgments have none
            self.counted[hop.message.kind] += size
            self.passed[hop.sender] += size * (hop.sender != hop.message.sender)
        if not sizes:
            self.counted["acknowledgment"] += ACKNOWLEDGMENT * sum(map(len, reached))
        return super()._heard(hops, reached, sizes)


def by_messages(history: History, params: DistributedParams, reviews: int) -> dict[str, float]:
    """Let the robots of a structure localize themselves; errors in R, and shares of what is sent.

    From where they take themselves to be by default, all rows at once go to the nearest minimum.

    Args:
        history: The structure.
        params: Settings of the robots.
        reviews: Times that robots solve again at the end; errors and bytes are those after each.
    """
    log = centered(observe(history, NOISY))
    header, lines = lines_of(log)
    swarm = PeerSwarm(header, params)
    swarm.channel = channel = _Counting(params, swarm._hear)  # noqa: SLF001 - counts for it
    channel.counted, channel.passed = Counter(), Counter()
    for line in lines:
        swarm.join(line)
    true = (history.position - history.position[0]) / log.dock_radius
    found = {"robots": len(lines), "joint_R": _error(_by_joint(log, len(lines)), true)}
    for times in range(max(reviews, params.reviews) + 1):
        if times:
            swarm.review()
        solution = swarm.solution()
        position = solution.position
        found[f"reviewed_{times}_R"] = _error(position, true)
        found[f"sent_{times}_B"] = float(np.mean(channel.sent))
        found[f"worst_sent_{times}_B"] = max(channel.sent)
        if times == params.reviews:
            found["nearest_R"] = _error(_nearest(log, params, position), true)
            is_off = np.linalg.norm(position - true, axis=1) > 1.0
            found["off_by_1R"] = int(is_off.sum())
            found["off_and_doubt"] = int((is_off & solution.doubtful).sum())
            found["others_that_doubt"] = int((~is_off & solution.doubtful).sum())
            found["worst_robot"] = worst = int(np.argmax(channel.sent))
            found["worst_passes_on"] = channel.passed[worst] / channel.sent[worst]
            total = sum(channel.counted.values())
            assert total == sum(channel.sent)  # noqa: S101 - nothing is left out
            for kind, size in sorted(channel.counted.items()):
                found[f"{kind}_share"] = size / total
    return found


def _nearest(log: SensingLog, params: DistributedParams, position: Reals) -> Reals:
    """Move robots to the nearest minimum of all rows, from some places [R], shape (N, 3)."""
    posed = Posed(log, params, pose_problem(log, params))
    cost = posed.cost(posed.problem.rows, links=posed.problem.connections, robust_sd=ROBUST_SD)
    return cost.refine(cost.at(position, np.zeros(len(position))))[0].position


def _error(position: Reals, true: Reals) -> float:
    return _rms(np.linalg.norm(position - true, axis=1))


def _tracked(log: SensingLog) -> tuple[Tracker, Reals, Reals, Reals, np.ndarray]:
    """Let all robots join: the tracker, places, sd, time [ms], and whether chains annealed."""
    header, *lines = map(json.dumps, log_entries(log))
    tracker = Tracker(header)
    places, sd, cpu_ms, annealed = [], [], [], []
    for line in lines:
        begun = time.process_time()
        change = tracker.join(line)
        cpu_ms.append(1e3 * (time.process_time() - begun))
        places.append(tracker.positions[-1])
        sd.append(tracker.sd[-1])
        annealed.append(change.annealed)
    return tracker, np.array(places), np.array(sd), np.array(cpu_ms), np.array(annealed)


def _by_joint(log: SensingLog, robots: int) -> Reals:
    """Localize the first robots of a log by `joint`, shape (robots, 3)."""
    header, lines = lines_of(log)
    builder = SensingLogBuilder(header)
    for line in lines[:robots]:
        builder.add(line)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # verdicts are not what is measured
        return localize(builder.log(), JointParams()).position


def _rms(values: Reals) -> float:
    return float(np.sqrt((values**2).mean()))


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Average structures by kind and size; errors of single robots by their squares."""
    columns = {}
    for name, group in table.groupby(["kind", "robots"]):
        mean = group.drop(columns=["kind", "seed", "robots", "worst_ms"]).mean()
        for key in ("last_R", "last_joint_R"):
            mean[key] = _rms(group[key].to_numpy())
        mean["structures"], mean["at_join_se_R"] = len(group), group["at_join_R"].sem()
        mean["final_of_joint"] = mean["final_R"] / mean["joint_R"]
        mean["last_of_joint"] = mean["last_R"] / mean["last_joint_R"]
        mean["worst_ms"] = group["worst_ms"].max()
        columns[name] = mean
    return pd.DataFrame(columns)


def summary_of_messages(table: pd.DataFrame) -> pd.DataFrame:
    """Average structures by kind and size, with half the width of 95 % confidence intervals.

    Bridges are of all sizes.
    """
    columns = {}
    size = table["robots"].astype(str).where(table["kind"] != "bridge", "closed")
    for (kind, robots), group in table.groupby(["kind", size]):
        # Not every structure has every kind of message.
        numbers = group.drop(columns=["kind", "seed", "robots"]).fillna(0.0)
        means = {name: mean_std_ci95(values.to_numpy(float)) for name, values in numbers.items()}
        for part in ("mean", "ci95"):
            columns[kind, robots, part] = {name: found[part] for name, found in means.items()}
    return pd.DataFrame(columns)


if __name__ == "__main__":
    main()
