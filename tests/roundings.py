"""A trial of tests: whether they hold under other roundings than those of this machine.

    python -m tests.roundings                                   # numerical rooms, all kinds
    python -m tests.roundings --kinds skylakex busy -- tests/localization/online/test_online.py

Another processor rounds otherwise, as libraries choose other code for it. Here variables make them
choose. A row of the table says what a kind changed: digests of values of numpy, BLAS and libm that
differ from those of this machine. The library of the kernels compiles for the processor that it
finds, and no variable changes that; the other library has another compiler, and rounds otherwise.
"""

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from tiswarm.compute.numerics import simd_features

REPOSITORY = Path(__file__).parents[1]
ROOMS = ("app", "compute", "engine", "evaluation", "formats", "localization", "measurements",
         "report", "sensing", "study", "world")  # fmt: skip
"""Rooms whose tests compare numbers."""

OTHER_LIBRARY = "quadrants"
_PROBE = "from tiswarm.app.doctor import name_numerics; print(name_numerics('cpu'))"
_SPIN = "import os; parent = os.getppid()\nwhile os.getppid() == parent: sum(range(10**6))"
"""Computes until its parent ends, however that ends."""


def _numpy_features(prefix: str) -> str:
    """List features of this processor for which numpy has code, by the start of their names."""
    return " ".join(name for name in simd_features() if name.startswith(prefix))


KINDS: dict[str, Mapping[str, str]] = {
    "own": {},
    "no-fma": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4"},
    "no-avx2": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2"},
    "no-avx512": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F"},
    "numpy-avx2": {"NPY_DISABLE_CPU_FEATURES": _numpy_features("AVX512")},
    "numpy-baseline": {"NPY_DISABLE_CPU_FEATURES": _numpy_features("")},
    "prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "sandybridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
    OTHER_LIBRARY: {"TISWARM_BACKEND": OTHER_LIBRARY},
    "all": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2",
        "NPY_DISABLE_CPU_FEATURES": _numpy_features(""),
        "OPENBLAS_CORETYPE": "Prescott",
    },
    "busy": {},
}
"""Variables by kind. `busy` has two processes beside it that compute without end."""


class Row(NamedTuple):
    """What the tests of one kind gave."""

    kind: str
    changes: str
    """Libraries whose values differ from those of this machine, with what they chose."""

    tests: int
    failed: list[str]
    cpu_s: float
    wall_s: float


def numerics_of(kind: str) -> dict[str, str]:
    """Name what rounds numbers under a kind, as a child process finds it."""
    done = subprocess.run(
        [sys.executable, "-c", _PROBE],
        cwd=REPOSITORY, env=os.environ | KINDS[kind], capture_output=True, text=True, check=True,
    )  # fmt: skip
    return dict(json.loads(done.stdout.splitlines()[-1]))


def tried(kind: str, tests: Sequence[str], own: Mapping[str, str]) -> Row:
    """Run tests under a kind, in one process."""
    found = numerics_of(kind)
    changed = {name: text for name, text in found.items() if text != own[name]}
    begun, spent = time.monotonic(), _children_s()
    with ExitStack() as beside, tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        if kind == "busy":
            for _ in range(2):
                other = beside.enter_context(subprocess.Popen([sys.executable, "-c", _SPIN]))
                beside.callback(other.kill)
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider"]
        done = subprocess.run(
            [*command, f"--junitxml={report}", *tests],
            cwd=REPOSITORY, env=os.environ | KINDS[kind], capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        # Those beside have not been waited for yet: their time does not count.
        cpu_s = _children_s() - spent
        if not report.exists():
            raise SystemExit(f"{kind}: no tests ran:\n{done.stdout}{done.stderr}")
        suite = ET.parse(report).getroot()[0]  # noqa: S314 - our own file
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return Row(
        kind=kind,
        changes=", ".join(f"{name}: {text}" for name, text in changed.items()),
        tests=int(suite.attrib["tests"]) - int(suite.attrib["skipped"]),
        failed=failed,
        cpu_s=cpu_s,
        wall_s=time.monotonic() - begun,
    )


def _children_s() -> float:
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def main() -> int:
    """Run tests under each kind, and print a table; return 1 if any failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=[*KINDS])
    parser.add_argument("tests", nargs="*", help="rooms, files or tests; all numerical rooms")
    asked = parser.parse_args()
    rooms = {room: f"tests/{room}" for room in ROOMS}
    tests = [rooms.get(name, name) for name in asked.tests or ROOMS]
    own = numerics_of("own")
    print(*(f"{name}: {text}" for name, text in own.items()), sep="\n")
    print("\n| kind | tests | failed | CPU s | wall s | changes |\n|---|---|---|---|---|---|")
    failed: list[str] = []
    for kind in asked.kinds:
        if kind == OTHER_LIBRARY and find_spec(OTHER_LIBRARY) is None:
            print(f"| {kind} | 0 | 0 | 0 | 0 | not installed: pip install {OTHER_LIBRARY} |")
            continue
        row = tried(kind, tests, own)
        cells = (kind, row.tests, len(row.failed), f"{row.cpu_s:.0f}", f"{row.wall_s:.0f}")
        print("|", " | ".join(map(str, cells)), "|", row.changes or "none", "|", flush=True)
        failed += [f"{kind}: {name}" for name in row.failed]
    print(*failed, sep="\n")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
