"""Compares how long everyday computations take with stored baselines.

    python -m benchmarks.compare                     # all works; status 1 if one is slower
    python -m benchmarks.compare --works growth      # some
    python -m benchmarks.compare --store             # makes what is measured the baseline

Each round times a work between two calibration loops, on one thread, in processor time. What is
compared is the median of their ratios, because a machine that is slower or busier is so for both.
The scatter is the range of the middle half of the rounds. A work is slower where its ratio has
grown by more than the scatters of both runs together.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

import tiswarm
from benchmarks.logs.__main__ import FOLDER as LOGS
from benchmarks.swarm_step.machine import describe
from benchmarks.threads import WORKS, Task, Work
from tiswarm.compute import backend
from tiswarm.localization.methods import LocalizationParams, localize_many
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.study.provenance import package_code

BASELINES = Path(__file__).with_name("baselines")
SMALL_LOGS = ("tower-contacts", "cantilever-contacts")


def _localize_logs(params: LocalizationParams) -> Callable[[int], Task]:
    def prepared(count: int) -> Task:
        logs = [tiswarm.read_log(LOGS / f"{name}.jsonl") for name in SMALL_LOGS[:count]]
        return lambda: localize_many(logs, [params] * count)

    return prepared


COMPARED = {
    "growth": WORKS["growth"]._replace(amount=8),
    "virtual-force": WORKS["virtual-force"]._replace(amount=16),
    "joint": WORKS["joint"]._replace(amount=2),
    "swarm step": WORKS["swarm step"]._replace(amount=50_000),
    "least-squares": Work(_localize_logs(LeastSquaresParams()), 2, "small logs"),
    "hop-by-hop": Work(_localize_logs(HopByHopParams()), 2, "small logs"),
}
"""Works of a second or less, each with the amount that is timed."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """A work as it was timed."""

    work: str
    amount: int
    unit: str
    rounds: int
    ratio: float
    """Median over the rounds of the work's processor time, in that of the calibration [1]."""
    scatter: float
    """Distance between the quartiles of that ratio, relative to the median [1]."""
    cpu_s: float
    calibration_s: float
    code: str = field(default_factory=package_code)
    """Digest of the code that grows and localizes."""
    machine: dict[str, object] = field(default_factory=describe)


def calibrate() -> None:
    """Work for a tenth of a second as tiswarm does: Python, arrays in cache, arrays in memory."""
    total: dict[int, int] = {}
    for n in range(300_000):
        total[n % 97] = total.get(n % 97, 0) + n
    small, large = np.linspace(1.0, 2.0, 3_000), np.linspace(1.0, 2.0, 1_000_000)
    for _ in range(1_500):
        small = np.sqrt(small * small + 1.0) - 0.4
    for _ in range(6):
        large = np.sqrt(large * large + 1.0) - 0.4


def timed(name: str, amount: int, rounds: int) -> Timing:
    """Time a work and the calibration in turn, once both are warm."""
    task = COMPARED[name].prepare(amount)
    marks = []
    for _ in range(rounds + 1):
        begun = time.process_time()
        calibrate()
        between = time.process_time()
        task()
        after = time.process_time()
        calibrate()
        marks.append((begun, between, after, time.process_time()))
    # The first round compiles kernels.
    before, cpu, behind = np.diff(marks[1:]).T
    calibration = (before + behind) / 2.0
    ratio = float(np.median(cpu / calibration))
    return Timing(
        work=name,
        amount=amount,
        unit=COMPARED[name].unit,
        rounds=rounds,
        ratio=ratio,
        scatter=float(np.diff(np.percentile(cpu / calibration, [25, 75]))[0] / ratio),
        cpu_s=float(np.median(cpu)),
        calibration_s=float(np.median(calibration)),
    )


def compared(now: Timing, stored: dict[str, object]) -> tuple[str, str]:
    """Compare a timing with a baseline of the same work.

    Returns:
        A row of the table, and its verdict: slower, faster, within scatter, or of another amount.
    """
    before, scatter = float(stored["ratio"]), float(stored["scatter"]) + now.scatter
    change = now.ratio / before - 1.0
    verdict = "within scatter"
    if stored["amount"] != now.amount:
        verdict = f"not comparable: the baseline is of {stored['amount']} {now.unit}"
    elif change > scatter:
        verdict = "slower"
    elif 1.0 / (1.0 + change) - 1.0 > scatter:
        verdict = "faster"
    figures = f"{before:.3g}", f"{now.ratio:.3g}", f"{change:+.0%}", f"{scatter:.0%}"
    cpu = f"{stored['cpu_s']:.3g}", f"{now.cpu_s:.3g}"
    return f"| {' | '.join([now.work, *figures, *cpu, verdict])} |", verdict


def main() -> int:
    """Time works; store them, or print how they compare."""
    options = _options()
    backend.start(threads=1)
    if not options.store:
        print("| work | ratio before | now | change | scatter | CPU s before | now | |")
        print("|---" * 8 + "|")
    verdicts = []
    for name in options.works:
        now = timed(name, max(1, round(options.share * COMPARED[name].amount)), options.rounds)
        file = options.baselines / f"{name.replace(' ', '-')}.json"
        if options.store:
            options.baselines.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(asdict(now), indent=1) + "\n")
            print(f"{file}: ratio {now.ratio:.3g}, scatter {now.scatter:.0%}", flush=True)
        elif file.exists():
            row, verdict = compared(now, json.loads(file.read_text()))
            verdicts.append(verdict)
            print(row, flush=True)
        else:
            print(f"| {name} | | {now.ratio:.3g} | | | | {now.cpu_s:.3g} | no baseline; --store |")
    return int("slower" in verdicts)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--works", nargs="+", choices=COMPARED, default=list(COMPARED))
    parser.add_argument("--rounds", type=int, default=9, help="rounds of each work (default: 9)")
    parser.add_argument("--share", type=float, default=1.0, help="share of each work (default: 1)")
    parser.add_argument("--store", action="store_true", help="make this run the baseline")
    parser.add_argument("--baselines", type=Path, default=BASELINES, metavar="FOLDER")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
