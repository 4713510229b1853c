"""Studies: run, store, resume and tabulate cases, which are seeds x sweep points x conditions.

No other room holds the truth and an estimate together.
"""

from tiswarm.study.cases import plan
from tiswarm.study.executors import Execution
from tiswarm.study.forecast import forecast
from tiswarm.study.run import open_folder, run, tabulate
from tiswarm.study.tables import COMPARISON, compare

__all__ = [
    "COMPARISON", "Execution", "compare", "forecast", "open_folder", "plan", "run", "tabulate",
]  # fmt: skip
