"""Compares the rules of growth in docs/guides/rules.md, and draws a structure of each.

python -m benchmarks.rules
"""

import argparse
import re
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import tiswarm
from benchmarks.images import draw_forces, save
from tiswarm.base.aliases import Reals

PAGE = Path("docs/guides/rules.md")
SHOWN = {
    "reactive-build": "ReactiveBuild",
    "random": "random",
    "ramp": "ramp",
    "early-call": "early call",
}
"""Rules of the picture, and what it calls them."""

_CODE = re.compile(r"```python\n(.*?)```", re.DOTALL)


class Compared(NamedTuple):
    """Structures of one rule: values of each, shape (S,)."""

    rule: str
    height: Reals  # [R]
    radius: Reals  # root mean square distance of robots from their mean [R]
    peak: Reals  # largest stress in any contact of the finished structure [weight of a dock / R^2]
    flips: Reals  # of a robot
    cpu_ms: float  # a structure

    @property
    def row(self) -> str:
        """Row of the table: means over structures, standard deviations in parentheses."""
        each = (self.height, self.radius, self.peak, self.flips)
        texts = [f"{x.mean():.1f} ({x.std(ddof=1):.1f})" for x in each]
        return f"| `{self.rule}` | {' | '.join(texts)} | {self.cpu_ms:.0f} |"


def compare(
    rules: Sequence[str], *, robots: int, seeds: int, page: Path = PAGE
) -> list[tuple[Compared, Any]]:
    """Grow towers by rules of the page, and return values and structures of each rule."""
    code = "\n\n".join(_CODE.findall(page.read_text(encoding="utf-8")))
    found = []
    with TemporaryDirectory() as folder:
        file = Path(folder, "rules.py")
        file.write_text(code, encoding="utf-8")
        for rule in rules:
            given = {"kind": "tower", "rule": rule}
            options = {"plugins": [file], "threads": 1, "quiet": True}
            tiswarm.grow(given, 8, 1, **options)  # compiles
            start = time.process_time()
            grown = tiswarm.grow(given, robots, seeds, **options)
            cpu_ms = 1e3 * (time.process_time() - start) / seeds
            away = grown.position - grown.position.mean(axis=1, keepdims=True)
            compared = Compared(
                rule=rule,
                height=grown.height,
                radius=np.sqrt((away**2).sum(axis=2).mean(axis=1)),
                peak=grown.peak_stress[:, -1],
                flips=grown.flips.mean(axis=1),
                cpu_ms=cpu_ms,
            )
            found.append((compared, grown))
    return found


def main() -> None:
    """Print the table and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--renderer", default="open3d", choices=["open3d", "taichi"])
    arguments = parser.parse_args()
    rules = ["reactive-build", "reactive-build-python", *[*SHOWN][1:]]
    found = compare(rules, robots=arguments.robots, seeds=arguments.seeds)
    print("| rule | height [R] | rms radius [R] | peak stress | flips | CPU [ms] |")
    print("|---|---|---|---|---|---|")
    for compared, _ in found:
        print(compared.row)
    views = [
        (SHOWN[compared.rule], grown[0]._shown())  # noqa: SLF001
        for compared, grown in found
        if compared.rule in SHOWN
    ]
    save(draw_forces(views, arguments.renderer), "rules")


if __name__ == "__main__":
    main()
