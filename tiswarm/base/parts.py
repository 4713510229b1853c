"""Optional parts of the package: registries name their modules as text, so nothing imports them.

A copy of the package without one of them does all that the others do.
"""

from importlib import import_module
from typing import Any

from tiswarm.base.errors import EnvironmentTroubleError

_PACKAGE = __name__.partition(".")[0]


def load(place: str, use: str) -> Any:  # noqa: ANN401 - what a registry holds, it says itself
    """Import what a registry names: a module, or an attribute of one as `module:attribute`.

    Args:
        place: Name of the module, and of the attribute.
        use: What the user asked for, as the error names it.

    Raises:
        EnvironmentTroubleError: this copy of the package lacks the module, or one that it imports.
    """
    module, _, attribute = place.partition(":")
    try:
        found = import_module(module)
    except ModuleNotFoundError as error:
        if lack := lacking(error, use):
            raise lack from error
        raise
    return getattr(found, attribute) if attribute else found


def lacking(error: ModuleNotFoundError, use: str) -> EnvironmentTroubleError | None:
    """Return the error of a part that this copy lacks; None where a library is missing."""
    if not f"{error.name}.".startswith(f"{_PACKAGE}."):
        return None
    problem = f"{use} needs {error.name}, which this copy of {_PACKAGE} lacks; install all of it"
    return EnvironmentTroubleError(problem)
