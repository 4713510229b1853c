"""Times the kernels of a study, by stage.

    python -m benchmarks.kernels    # scenarios/scaling.yaml with 1,000 and 10,000 robots
    python -m benchmarks.kernels --scenario scenarios/tower.yaml
    python -m benchmarks.kernels --set 'sweep={robots: [300]}' --arch cuda

Processor time of one thread on the processor, wall-clock time on a card. A kernel's time includes
its launch from Python. What compiles and loads kernels, and small kernels, are rows of their own;
the rest of a stage is Python, NumPy, SciPy and files. All robots of `joint` and of Algorithm 1 at
once take each step together, so that lists are kernels of their own; small swarms take all steps in
one kernel otherwise, with the same bits.
"""

import argparse
import os
import platform
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import tiswarm
from tiswarm.base.params import ARCHS
from tiswarm.compute import backend, math_kernels
from tiswarm.compute.lang import ti
from tiswarm.compute.machine import machine
from tiswarm.engine import relax
from tiswarm.localization.chains.annealer import Annealer
from tiswarm.study.provenance import Costs

SCENARIO = "scenarios/scaling.yaml"
SIZES = [[1_000, 10, 20, 140.0], [10_000, 100, 200, 302.0]]
"""Robots, movers, joins between solves and height of the goal [R], as in the scenario."""
SMALL = 0.02
"""Share of its stage below which a kernel counts as small."""
COMPILING, REST = "compiling and loading kernels", "Python, NumPy, SciPy, files"


class Watch:
    """Time and launches of each kernel, by stage."""

    def __init__(self, clock: Callable[[], float], wait: Callable[[], None]) -> None:
        self.clock, self.wait, self.stage = clock, wait, ""
        self.whole: Counter[str] = Counter()
        self.spent: Counter[tuple[str, str]] = Counter()
        self.launches: Counter[tuple[str, str]] = Counter()

    def install(self) -> None:
        """Wrap what launches and compiles kernels, and the stages of a study."""
        kernel = type(math_kernels.probe_arithmetic._primal)  # noqa: SLF001 - the library shows none
        kernel.__call__ = self._timed(kernel.__call__, launches=True)
        kernel.materialize = self._timed(kernel.materialize, launches=False)
        Costs.stage = self._staged(Costs.stage)
        Annealer._is_quicker_by_block = lambda *_: False  # noqa: SLF001 - as the head says
        relax.SMALL = 0

    def _timed(self, function: Callable[..., Any], *, launches: bool) -> Callable[..., Any]:
        def timed(kernel: Any, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - of the library
            begun = self.clock()
            try:
                return function(kernel, *args, **kwargs)
            finally:
                if launches:
                    self.wait()
                name = kernel.func.__name__
                taken = self.clock() - begun
                self.spent[self.stage, name if launches else COMPILING] += taken
                self.launches[self.stage, name] += launches
                if not launches:  # its launch, which compiles, counts the same time
                    self.spent[self.stage, name] -= taken

        return timed

    def _staged(self, stage: Callable[..., Any]) -> Callable[..., Any]:
        @contextmanager
        def staged(costs: Costs, name: str, cases: Sequence[str]) -> Iterator[None]:
            condition = cases[0].rpartition(",")[2] if name == "localize" else ""
            before, self.stage = self.stage, f"{name} {condition}".strip()
            begun = self.clock()
            try:
                with stage(costs, name, cases):
                    yield
            finally:
                self.whole[self.stage] += self.clock() - begun
                self.stage = before

        return staged

    def rows(self) -> Iterator[str]:
        """Return rows of a table in Markdown: kernels of each stage, the longest first."""
        for stage, whole in self.whole.items():
            spent = {name: t for (of, name), t in self.spent.most_common() if of == stage}
            large = {name: t for name, t in spent.items() if t >= SMALL * whole}
            large["small kernels"] = sum(spent.values()) - sum(large.values())
            large[REST] = whole - sum(spent.values())
            for name, taken in large.items():
                launches = self.launches[stage, name] or ""
                yield f"| {stage} | {name} | {launches} | {taken:.3g} | {100 * taken / whole:.0f} |"


def main() -> None:
    """Run a study of each size and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", default=SCENARIO)
    parser.add_argument("--set", action="append", default=[], help="as of `tiswarm run`")
    parser.add_argument("--arch", choices=ARCHS, default="cpu")
    options = parser.parse_args()
    settings = [options.set]
    if options.scenario == SCENARIO and not options.set:
        keys = "robots, structure.movers, structure.solve_every, structure.goal_height"
        settings = [[f'sweep={{"{keys}": [{row}]}}', "seeds=1"] for row in SIZES]
    running = backend.start(options.arch, threads=1)
    print(f"machine: {machine()}, Python {platform.python_version()}, {running.library}")
    print(f"device: {running}, load before: {os.getloadavg()[0]:.2f}\n")
    clock, wait = (time.perf_counter, ti.sync) if running.on_card else (time.process_time, int)
    for changed in settings:
        watch = Watch(clock, wait)
        watch.install()
        with tempfile.TemporaryDirectory() as out:
            tiswarm.run(
                options.scenario, changed, out=out, arch=options.arch, threads=1, quiet=True,
                pictures=False,
            )  # fmt: skip
        print(" ".join(changed))
        print("\n| stage | kernel | launches | s | % |\n|---|---|---|---|---|")
        print("\n".join(watch.rows()), flush=True)


if __name__ == "__main__":
    main()
