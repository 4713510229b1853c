"""Grow large swarms of modular robots and localize them by their contacts.

    run = tiswarm.run("tower", {"robots": 20})          a scenario: grow, sense, localize, evaluate
    run.table, run.figures["convergence"]               its results: data frames and figures
    swarms = tiswarm.grow("tower", seeds=64)            structures alone, as arrays
    swarms.position, swarms.sense(tilt_noise_deg=1.0)   where robots are, and what they sense
    tiswarm.relax(position, turned, contacts, ...)      steps of the engine: forces on any swarm
    log = tiswarm.read_log("sensing.jsonl")             what a swarm of yours sensed
    estimate = log.localize("joint")                    where its robots are
    estimate.view(), tiswarm.advise(log, estimate)      a page, and what to measure next

Runs, structures and estimates have `view` and `export` of their own, and what a call returns
prints itself. `help(tiswarm.localize)` explains a call. A mistake in an argument or file is
an `InputError`. Functions and classes of yours become methods, sensors, structures, rules,
measures, figures and formats by `tiswarm.method` and the like. All names:
"""

import random
import re
from importlib import import_module
from typing import TYPE_CHECKING

from tiswarm.base.version import __version__

if TYPE_CHECKING:  # the one list of all names: the rest is read from it
    from tiswarm.api import advise as advise
    from tiswarm.api import check as check
    from tiswarm.api import check_local as check_local
    from tiswarm.api import compare as compare
    from tiswarm.api import design as design
    from tiswarm.api import export as export
    from tiswarm.api import grow as grow
    from tiswarm.api import import_poses as import_poses
    from tiswarm.api import localize as localize
    from tiswarm.api import open_swarms as open_swarms
    from tiswarm.api import read_log as read_log
    from tiswarm.api import redraw as redraw
    from tiswarm.api import run as run
    from tiswarm.api import score as score
    from tiswarm.api import track as track
    from tiswarm.api import view as view
    from tiswarm.app.formats import export_format as export_format
    from tiswarm.app.formats import import_format as import_format
    from tiswarm.app.results import Run as Run
    from tiswarm.app.results import open_run as open_run
    from tiswarm.app.steering import Growth as Growth
    from tiswarm.app.swarms import Swarms as Swarms
    from tiswarm.base.errors import EnvironmentTroubleError as EnvironmentTroubleError
    from tiswarm.base.errors import InputError as InputError
    from tiswarm.base.robot import RobotGeometry as RobotGeometry
    from tiswarm.compute.lang import ti as ti
    from tiswarm.engine.forces import relax as relax
    from tiswarm.engine.laws import force as force
    from tiswarm.engine.laws import integrator as integrator
    from tiswarm.engine.relax import RelaxResult as RelaxResult
    from tiswarm.localization.distributed.channels import channel as channel
    from tiswarm.localization.methods import method as method
    from tiswarm.localization.online.tracker import Tracker as Tracker
    from tiswarm.localization.virtual_force.method import Localizer as Localizer
    from tiswarm.records.measures import measure as measure
    from tiswarm.report.figures import figure as figure
    from tiswarm.sensing.suites import sensor as sensor
    from tiswarm.world.choices import reactive_build as reactive_build
    from tiswarm.world.ground.user import terrain as terrain
    from tiswarm.world.rules import rule as rule
    from tiswarm.world.rules import structure as structure
    from tiswarm.world.strength import strength as strength

_HOME = {
    name: module
    for module, name in re.findall(
        r"^    from (\S+) import \w+ as (\w+)$",
        __spec__.loader.get_source(__name__),  # type: ignore[union-attr]
        re.MULTILINE,
    )
}
"""Module of each name, as the list above has it."""

_FIRST = ("run", "grow", "relax", "localize")
"""Names that `help` lists before the others."""

__all__ = ["__version__", *sorted(_HOME)]  # noqa: PLE0604 - names are texts
__doc__ = "\n    ".join([__doc__ or "", *_FIRST, *sorted({*_HOME} - {*_FIRST})])


def __getattr__(name: str) -> object:
    """Import a name when it is used; `import tiswarm` alone loads no kernel compiler."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    drawn = random.getstate()
    try:
        return getattr(import_module(_HOME[name]), name)
    finally:
        random.setstate(drawn)  # rich draws numbers as it is imported


def __dir__() -> list[str]:
    """List the names that `__getattr__` imports, for completion and help."""
    return __all__
