"""Grow large swarms of modular robots and localize them by their contacts.

    run(scenario, overrides)         grow, sense, localize, evaluate and draw a scenario
    open_run(folder)                 results of an earlier run: data frames and figures
    compare(runs)                    runs side by side, and differences on the structures they share
    render(run), export(run, "ply")  3D pictures, and files for other programs; of a log, too
    read_log(path)                   read a sensing log
    import_poses(table)              make a log from robot poses of any simulator
    localize(log)                    estimate the positions of a log's robots
    track(stream)                    estimate them while the robots join
    advise(log, estimate)            which further measurement would help most
    view(log, estimate)              show an estimate on a page
    score(truth, estimate)           errors of an estimate
    check(path)                      mistakes in a scenario or log
    method(name)                     make a function of yours a localization method
    sensor(name, fills=...)          make a function of yours a sensor suite
    export_format(name, suffix)      make a function of yours a format to export to
    Localizer(header)                Algorithm 1 of the paper, one robot at a time
    Tracker(header)                  estimates of all robots as they join, one robot at a time
    relax(...)                       the step that moves a whole swarm

A run, a log and an estimate have `view`, `render` and `export` of their own, and what a call
returns prints itself. `help(tiswarm.localize)` explains a call. A mistake in an argument or file is
an `InputError`.
"""

import random
from importlib import import_module
from typing import TYPE_CHECKING

from tiswarm.base.version import __version__

if TYPE_CHECKING:
    from tiswarm.api import (
        advise,
        check,
        compare,
        export,
        import_poses,
        localize,
        read_log,
        render,
        run,
        score,
        track,
        view,
    )
    from tiswarm.app.exports import export_format
    from tiswarm.app.results import Run, open_run
    from tiswarm.base.errors import EnvironmentTroubleError, InputError
    from tiswarm.base.robot import RobotGeometry
    from tiswarm.engine.relax import RelaxResult, relax
    from tiswarm.localization.methods import method
    from tiswarm.localization.virtual_force.method import Localizer
    from tiswarm.parts.online.tracker import Tracker
    from tiswarm.sensing.plugins import sensor

__all__ = [
    "EnvironmentTroubleError",
    "InputError",
    "Localizer",
    "RelaxResult",
    "RobotGeometry",
    "Run",
    "Tracker",
    "__version__",
    "advise",
    "check",
    "compare",
    "explain",
    "export",
    "export_format",
    "import_poses",
    "localize",
    "method",
    "open_run",
    "read_log",
    "relax",
    "render",
    "run",
    "score",
    "sensor",
    "track",
    "view",
]

_HOME = {
    "EnvironmentTroubleError": "tiswarm.base.errors",
    "InputError": "tiswarm.base.errors",
    "Localizer": "tiswarm.localization.virtual_force.method",
    "RelaxResult": "tiswarm.engine.relax",
    "RobotGeometry": "tiswarm.base.robot",
    "Run": "tiswarm.app.results",
    "Tracker": "tiswarm.parts.online.tracker",
    "export_format": "tiswarm.app.exports",
    "method": "tiswarm.localization.methods",
    "open_run": "tiswarm.app.results",
    "relax": "tiswarm.engine.relax",
    "sensor": "tiswarm.sensing.plugins",
}
"""Module of each name that is not in `tiswarm.api`."""


def __getattr__(name: str) -> object:
    """Import a name when it is used; `import tiswarm` alone loads no kernel compiler."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    drawn = random.getstate()
    try:
        return getattr(import_module(_HOME.get(name, "tiswarm.api")), name)
    finally:
        random.setstate(drawn)  # rich draws numbers as it is imported


def __dir__() -> list[str]:
    """List the names that `__getattr__` imports, for completion and help."""
    return __all__
