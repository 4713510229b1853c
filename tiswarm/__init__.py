"""tiswarm: grow large swarms of modular robots and localize them by their contacts."""

from importlib import import_module
from typing import TYPE_CHECKING

from tiswarm.version import __version__

if TYPE_CHECKING:
    from tiswarm.api import localize, read_log, run
    from tiswarm.engine.relax import RelaxResult, relax
    from tiswarm.localization.virtual_force import Localizer

__all__ = ["Localizer", "RelaxResult", "__version__", "localize", "read_log", "relax", "run"]

_HOME = {
    "Localizer": "tiswarm.localization.virtual_force",
    "RelaxResult": "tiswarm.engine.relax",
    "localize": "tiswarm.api",
    "read_log": "tiswarm.api",
    "relax": "tiswarm.engine.relax",
    "run": "tiswarm.api",
}


def __getattr__(name: str) -> object:
    """Import a name when it is used; `import tiswarm` alone loads no kernel compiler."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
