"""Studies: cases are seeds x sweep points x conditions; run, stored, resumed, tabulated.

The only room that holds the truth and an estimate together.
"""

from tiswarm.study.cases import plan
from tiswarm.study.forecast import forecast
from tiswarm.study.pool import Dispatch
from tiswarm.study.run import RunResult, run, tabulate
from tiswarm.study.slurm import Slurm, job_script
from tiswarm.study.tables import headline
from tiswarm.study.tuning import tune

__all__ = [
    "Dispatch",
    "RunResult",
    "Slurm",
    "forecast",
    "headline",
    "job_script",
    "plan",
    "run",
    "tabulate",
    "tune",
]
