"""tiswarm from Python: a log in, an estimate out.

import tiswarm

log = tiswarm.read_log("sensing.jsonl")
estimate = tiswarm.localize(log, "least-squares", cues=["contacts", "height"], rounds=3)
estimate.position, estimate.certainty.known
"""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from tiswarm.compute import backend
from tiswarm.compute.choices import Arch, Precision
from tiswarm.localization import registry
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario import localization_params


def read_log(path: str | PathLike[str]) -> SensingLog:
    """Read a sensing log, `sensing.jsonl`.

    Raises:
        InputError: the file cannot be read or a line is malformed; tells file, line and key.
    """
    return read_sensing_log(Path(path))


def localize(
    log: SensingLog | str | PathLike[str],
    method: str = "virtual-force",
    *,
    cues: Sequence[str] | None = None,
    arch: Arch = "cpu",
    threads: int | None = None,
    precision: Precision = "f64",
    **settings: object,
) -> Estimate:
    """Work out where the robots of a log are, as `tiswarm localize` does.

    Args:
        log: What the swarm sensed, or the file with it.
        method: Name of the method.
        cues: What of the log to use, and no more; what the method does by itself if None.
        arch: Device; it computes there or an error is raised.
        threads: CPU threads; all that this process may use if None.
        precision: Real type of the kernels.
        settings: Settings of the method by name, nested ones as dictionaries.

    Raises:
        InputError: for a bad log, method, cue or setting.
        EnvironmentTroubleError: where the machine lacks the device.
    """
    params = localization_params(method, cues=cues, values=settings)
    sensed = log if isinstance(log, SensingLog) else read_log(log)
    backend.start(arch, threads=threads, precision=precision)
    return registry.localize(sensed, params)
