"""What works on this machine, and what to install for what does not."""

import subprocess
import sys
from collections.abc import Iterator
from typing import NamedTuple

from tiswarm.params import ARCHS
from tiswarm.report.render.packages import missing_packages
from tiswarm.report.render.probe import probe_renderers
from tiswarm.study.manifest import machine

PROBE_SECONDS = 60


class Finding(NamedTuple):
    """One thing that was looked at, and what was found or what to do."""

    subject: str
    works: bool
    detail: str


def examine() -> Iterator[Finding]:
    """Look at the machine, the backends and the renderers, one after the other."""
    for name, value in machine().items():
        unit = " MB" if name.endswith("_MB") else ""
        yield Finding(name.replace("_MB", ""), works=True, detail=f"{value}{unit}")
    for arch in ARCHS:
        yield Finding(f"backend {arch}", *_backend(arch))
    for status in probe_renderers():
        yield Finding(f"renderer {status.name}", status.works, status.detail)
    if packages := missing_packages():
        detail = f"for open3d: apt-get install {' '.join(packages)}"
        yield Finding("system packages", works=False, detail=detail)


def _backend(arch: str) -> tuple[bool, str]:
    """Start a backend in a process of its own, for a bad driver may take the process along."""
    code = (
        "import sys; from tiswarm.compute import backend; from tiswarm.errors import TiswarmError\n"
        "try: b = backend.start(sys.argv[1]); print(f'{b.library}, {b.threads} threads')\n"
        "except TiswarmError as e: sys.exit(str(e))"
    )
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and code
            [sys.executable, "-c", code, arch],
            capture_output=True, text=True, timeout=PROBE_SECONDS, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False, f"no answer in {PROBE_SECONDS} s"
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return done.returncode == 0, said[-1] if said else f"died with status {done.returncode}"
