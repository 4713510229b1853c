"""What robots build by, as a caller of `tiswarm.grow` or `tiswarm.Growth` says it.

It is what a scenario says by `structure.navigate_by`, `structure.belief_error`, `sensing` and
`localization`. A caller may give a function of its own in place of a method.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tiswarm.app.logs import Log
from tiswarm.app.results import Section, as_section
from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.params import METHOD
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.study.navigation import BelievedPlaces, Place, placed_by

Believer: TypeAlias = Callable[[Log], "ArrayLike | tuple[ArrayLike, ArrayLike] | Estimate"]
"""Function of the log of robots that have joined, in join order, which returns where they believe
to be: centers [R], shape (n, 3), these with their standard deviations [R], shape (n,), or what
`log.localize` returns."""

_KNOWN = {"truth": "know the truth", "error": "go by the truth and an error"}
"""By `navigate_by`, what robots do that estimate nothing."""


@dataclass(frozen=True, kw_only=True)
class Navigation:
    """Arguments of `tiswarm.grow` that say what robots build by."""

    navigate_by: str | None = None
    """`structure.navigate_by`; as the structure or the other arguments say if None."""

    belief_error: Section | None = None
    """`structure.belief_error`."""

    believe: Section | Believer | None = None
    """Method by which robots estimate where they are, or a function that does so."""

    sensing: Mapping[str, object] | None = None
    """Settings of `sensing`."""

    @property
    def place(self) -> Place | None:
        """The function of the caller that places robots; None if a method does."""
        believe: Any = self.believe
        return _place_by(believe) if _is_function(believe) else None

    def sections(self, structure: Mapping[str, object]) -> dict[str, object]:
        """Write the sections of a scenario that say what robots build by.

        Args:
            structure: Section `structure` without what these arguments say.

        Raises:
            InputError: arguments contradict each other, or one is missing.
        """
        by = self._navigate_by(structure.get("navigate_by"))
        self._check(by)
        whole = {**structure, "navigate_by": by}
        if self.belief_error is not None:
            whole["belief_error"] = as_section(self.belief_error, "kind")
        sections: dict[str, object] = {"structure": whole, "localization": {"method": METHOD}}
        if self.believe is not None and not _is_function(self.believe):
            sections["localization"] = as_section(self.believe, "method")
        if self.sensing is not None:
            sections["sensing"] = self.sensing
        return sections

    def _navigate_by(self, stated: object) -> object:
        """Return what robots navigate by, where the structure states something or None."""
        if self.navigate_by is not None:
            return self.navigate_by
        if stated not in (None, "truth"):
            return stated
        if self.believe is not None:
            return "estimate"
        return "truth" if self.belief_error is None else "error"

    def _check(self, by: object) -> None:
        """Refuse arguments that do not go together.

        Raises:
            InputError: they do not.
        """
        if by == "estimate" and self.believe is None:
            problem = "robots that build by estimates need a method; give believe, as "
            problem += 'believe="online", or a function of their log'
            raise InputError(problem, key="structure.navigate_by")
        if by in _KNOWN and self.believe is not None:
            problem = f"robots that {_KNOWN[str(by)]} estimate nothing; leave believe out, or set "
            raise InputError(f"{problem}navigate_by to estimate", argument="believe")
        if by == "truth" and self.sensing is not None:
            problem = "robots that know the truth go by no sensor; leave sensing out, or give "
            raise InputError(f"{problem}believe or belief_error", argument="sensing")


def _is_function(believe: object) -> bool:
    """Whether this is a function of a log, and no section of settings."""
    return callable(believe) and not isinstance(believe, type)


def _place_by(believe: Believer) -> Place:
    """Return what places the robots of a log by a function of the caller."""

    def place(log: SensingLog) -> BelievedPlaces:
        returned = believe(Log.of(log))
        if isinstance(returned, Estimate):
            return placed_by(returned)
        center: Any = returned
        sd: Any = None
        if isinstance(returned, tuple) and len(returned) == 2 and np.ndim(returned[0]) > 1:  # noqa: PLR2004 - a pair
            center, sd = returned
        robots = log.robot_count
        unknown = np.full(robots, np.nan)
        return BelievedPlaces(
            _checked(center, (robots, 3), np.isfinite),
            unknown if sd is None else _checked(sd, (robots,), _is_no_negative),
            unknown,
        )

    return place


def _is_no_negative(sd: Reals) -> Any:  # noqa: ANN401 - truth values
    """Whether standard deviations are 0 or more, or NaN."""
    return ~(sd < 0.0)


def _checked(values: Any, shape: tuple[int, ...], is_valid: Callable[[Reals], Any]) -> Reals:  # noqa: ANN401
    """Return what a function of a caller returned as an array.

    Raises:
        InputError: it is none of this shape, or has values that are not valid.
    """
    try:
        array: Reals = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not is_valid(array).all():
        robots = shape[0]
        problem = f"returned {type(values).__name__} of shape {np.shape(array)}; return finite "
        problem += f"centers of shape ({robots}, 3), with sd from 0 up of shape ({robots},) if any"
        raise InputError(problem, argument="believe")
    return array
