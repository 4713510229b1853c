"""Jobs of SLURM that become the workers of a Dask cluster, by dask-jobqueue."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import NamedTemporaryFile
from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.errors import EnvironmentTroubleError, InputError
from tiswarm.params import STRICT


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Slurm:
    """Jobs to ask for; what else they need stands in dask-jobqueue's own configuration."""

    jobs: Annotated[int, Field(ge=1)]
    """Jobs at the same time."""

    cores: Annotated[int, Field(ge=1)]
    """Cores of each."""

    memory: str
    """Memory of each, such as 8GB."""

    walltime: str | None = None
    """Longest time of each, such as 02:00:00; a job that ended its work is followed by another."""

    queue: str | None = None
    """Partition."""

    account: str | None = None
    """Who pays."""

    interface: str | None = None
    """Network by which jobs and this machine reach each other, such as ib0."""


def job_script(slurm: Slurm, threads: int) -> str:
    """Write what is submitted for each job, but for the address of the scheduler.

    Raises:
        EnvironmentTroubleError: dask-jobqueue is missing.
        InputError: a setting makes no sense to it.
    """
    job = _library().slurm.SLURMJob
    with _blamed(slurm):
        script: str = job(
            "tcp://THIS-MACHINE", name="worker", **_settings(slurm, threads)
        ).job_script()
    return script


@contextmanager
def submitted(slurm: Slurm, threads: int) -> Iterator[Any]:
    """Submit jobs, and others when these end; cancel them with the block.

    Args:
        slurm: What to ask for.
        threads: Cores that each thread of a worker computes on.

    Raises:
        EnvironmentTroubleError: dask-jobqueue or sbatch is missing, or sbatch takes no such job.
        InputError: a setting makes no sense to dask-jobqueue.
    """
    library = _library()
    if shutil.which("sbatch") is None:
        msg = "--slurm needs sbatch, which is not here; log in where SLURM is, or use --workers"
        raise EnvironmentTroubleError(msg)
    with NamedTemporaryFile("w", suffix=".sh") as script:
        script.write(job_script(slurm, threads))
        script.flush()
        _try_out(script.name)
    scheduler = {"dashboard_address": ":0"}
    with library.SLURMCluster(**_settings(slurm, threads), scheduler_options=scheduler) as cluster:
        cluster.adapt(minimum_jobs=slurm.jobs, maximum_jobs=slurm.jobs)
        yield cluster


def _library() -> Any:  # noqa: ANN401 - it has no types
    try:
        import dask_jobqueue  # noqa: PLC0415 - an extra, and slow to import
    except ImportError as error:
        msg = "--slurm needs dask-jobqueue; pip install 'tiswarm[cluster]'"
        raise EnvironmentTroubleError(msg) from error
    return dask_jobqueue


def _settings(slurm: Slurm, threads: int) -> dict[str, Any]:
    """Settings of each job: one worker, whose threads each compute in a process of their own."""
    return {
        "cores": max(1, slurm.cores // threads),
        "job_cpu": slurm.cores,
        "job_name": "tiswarm",
        "processes": 1,
        "memory": slurm.memory,
        "walltime": slurm.walltime,
        "queue": slurm.queue,
        "account": slurm.account,
        "interface": slurm.interface,
    }


@contextmanager
def _blamed(slurm: Slurm) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        msg = f"{slurm.memory!r} is no size; write it like 8GB"
        raise InputError(msg, key="--slurm memory") from error


def _try_out(script: str) -> None:
    """Ask SLURM whether it would take a job, for later nobody hears of it if not."""
    done = subprocess.run(  # noqa: S603 - our own script
        ["sbatch", "--test-only", script],  # noqa: S607 - wherever the cluster has it
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["it does not say why"])[-1]
        msg = f"sbatch takes no such job: {said}; correct --slurm"
        raise EnvironmentTroubleError(msg)
