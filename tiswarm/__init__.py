"""tiswarm: large swarms of modular robots that find out where they are by touch."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tiswarm.engine.relax import RelaxResult, relax

__version__ = "0.1.0"

__all__ = ["RelaxResult", "__version__", "relax"]

_HOME = {"RelaxResult": "tiswarm.engine.relax", "relax": "tiswarm.engine.relax"}


def __getattr__(name: str) -> object:
    """Load what is asked for, so that `import tiswarm` alone starts no kernel compiler."""
    if name not in _HOME:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(import_module(_HOME[name]), name)
