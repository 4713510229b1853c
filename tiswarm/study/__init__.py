"""Studies: run, store, resume and tabulate cases, which are seeds x sweep points x conditions.

No other room holds the truth and an estimate together.
"""

from tiswarm.scenario.expansion import plan
from tiswarm.study.executors import Execution
from tiswarm.study.run import run
from tiswarm.study.tables import open_folder, tabulate

__all__ = ["Execution", "open_folder", "plan", "run", "tabulate"]
