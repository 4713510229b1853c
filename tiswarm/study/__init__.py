"""Studies: cases are seeds x sweep points x conditions; run, stored, resumed, tabulated.

The only room that holds the truth and an estimate together.
"""

from tiswarm.study.run import RunResult, Watcher, run, tabulate
from tiswarm.study.tables import headline
from tiswarm.study.tuning import tune

__all__ = ["RunResult", "Watcher", "headline", "run", "tabulate", "tune"]
