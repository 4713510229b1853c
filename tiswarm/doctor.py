"""What works on this machine, and what to install for what does not."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from tiswarm.compute.choices import ARCHS
from tiswarm.report.render.probe import missing_packages, probe_renderers
from tiswarm.study.manifest import machine

__all__ = ["Finding", "examine", "missing_packages"]

PROBE_SECONDS = 60


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    subject: str
    """What was looked at."""

    works: bool
    """Whether it can be used."""

    detail: str
    """What was found, or what to do."""


def examine() -> Iterator[Finding]:
    """Look at the machine, the backends and the renderers, one after the other."""
    for name, value in machine().items():
        yield Finding(subject=name.replace("_MB", ""), works=True, detail=_with_unit(name, value))
    for arch in ARCHS:
        yield _backend(arch)
    for status in probe_renderers():
        yield Finding(subject=f"renderer {status.name}", works=status.works, detail=status.detail)
    packages = missing_packages()
    if packages:
        yield Finding(
            subject="system packages",
            works=False,
            detail=f"for open3d: apt-get install {' '.join(packages)}",
        )


def _with_unit(name: str, value: object) -> str:
    return f"{value} MB" if name.endswith("_MB") else str(value)


def _backend(arch: str) -> Finding:
    """Start a backend in a process of its own, for a bad driver may take the process along."""
    code = (
        "import sys; from tiswarm.compute import backend; from tiswarm.errors import TiswarmError\n"
        "try: b = backend.start(sys.argv[1]); print(f'{b.library}, {b.threads} threads')\n"
        "except TiswarmError as e: sys.exit(str(e))"
    )
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and code
            [sys.executable, "-c", code, arch],
            capture_output=True,
            text=True,
            timeout=PROBE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Finding(
            subject=f"backend {arch}", works=False, detail=f"no answer in {PROBE_SECONDS} s"
        )
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    detail = said[-1] if said else f"died with status {done.returncode}"
    return Finding(subject=f"backend {arch}", works=done.returncode == 0, detail=detail)
