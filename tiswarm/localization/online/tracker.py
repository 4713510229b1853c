"""Estimates the positions of all robots while they join.

A join measures the rows of the new robot alone, places it, and solves for the robots near it. The
whole structure is annealed once it has grown by a tenth. Lengths inside are in R.
"""

from typing import NamedTuple

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.params import LocalizationParams
from tiswarm.localization.virtual_force import Line
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog


class Change(NamedTuple):
    """What the line of one robot changed: K robots moved, the one that joined among them."""

    robot: Ints
    """Names of the robots that moved, in join order, shape (K,)."""

    position: Reals
    """Their centers now [log unit], shape (K, 3)."""

    moved: Reals
    """How far each moved [log unit], NaN for one that joined, shape (K,)."""

    sd: Reals
    """Standard deviation of each position now [log unit], shape (K,)."""

    annealed: bool
    """Whether the whole structure was annealed."""


class Tracker:
    """Estimates the positions of all robots while they join.

    The same lines give the same bytes, at any number of threads.
    """

    def __init__(self, header: Line, params: LocalizationParams | None = None) -> None:
        """Prepare for robots to join.

        Args:
            header: First line of a sensing file.
            params: Settings of `online`; its defaults if None.

        Raises:
            InputError: the header is malformed, or it states what a tracker cannot solve for.
        """
        raise NotImplementedError

    @property
    def log(self) -> SensingLog:
        """The sensing log of the robots so far."""
        raise NotImplementedError

    @property
    def names(self) -> Ints:
        """Names of the robots, in join order, shape (n,)."""
        raise NotImplementedError

    @property
    def positions(self) -> Reals:
        """Estimated centers in join order [log unit], shape (n, 3)."""
        raise NotImplementedError

    @property
    def sd(self) -> Reals:
        """Standard deviation of each position [log unit], shape (n,)."""
        raise NotImplementedError

    def join(self, robot: Line) -> Change:
        """Add the next robot; the first one is the anchor.

        Args:
            robot: Its line of a sensing file.

        Raises:
            InputError: the line is malformed, or says what a tracker cannot use. The robot leaves
                no trace then.
        """
        raise NotImplementedError

    def update(self, robot: Line) -> Change:
        """Replace the line of a robot that has joined, as after it has sensed more.

        Args:
            robot: Its new line, which names robots that joined before it, as the first one did.

        Raises:
            InputError: the line is malformed, or no such robot has joined.
        """
        raise NotImplementedError

    def leave(self, robot: int) -> Change:
        """Remove a robot, with all that later robots sensed of it.

        Args:
            robot: Its name.

        Raises:
            InputError: no such robot has joined, or it is the anchor.
        """
        raise NotImplementedError

    def estimate(self, *, final: bool = False) -> Estimate:
        """Return the estimate of all robots, with verdicts.

        Args:
            final: Whether to anneal the structure first and to look for several solutions, as
                `joint` does; else it is the present state, and later joins do not depend on the
                call.
        """
        raise NotImplementedError
