"""Goals of a design, and which candidates no other one surpasses.

| goal | meaning |
|---|---|
| `NAME<VALUE` | less than a value, and the smaller the better |
| `NAME>VALUE` | more than a value, and the larger the better |
| `min:NAME` | the smaller the better |
| `max:NAME` | the larger the better |
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError

_NAME = r"[A-Za-z]\w*"
_BOUNDED = re.compile(rf"({_NAME})\s*([<>])\s*([^\s<>=][^<>=]*)")
_UNBOUNDED = re.compile(rf"(min|max)\s*:\s*({_NAME})")
_FORMS = "write it like rmse_R<0.2, height_R>60, min:price or max:reach_R"


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What a result should be."""

    name: str
    """Name of the result."""

    larger: bool
    """Whether larger values are better, not smaller ones."""

    bound: float = math.nan
    """Value that the result should be beyond; NaN if any will do."""

    def __str__(self) -> str:
        """Write the goal as a user does."""
        if math.isnan(self.bound):
            return f"{'max' if self.larger else 'min'}:{self.name}"
        return f"{self.name}{'>' if self.larger else '<'}{self.bound:.12g}"

    def cost(self, values: Reals) -> Reals:
        """Return numbers that are smaller where values are better; infinite where unknown."""
        signed = -values if self.larger else values
        cost: Reals = np.where(np.isnan(signed), np.inf, signed)
        return cost

    def is_reached(self, values: Reals) -> Bools:
        """Whether each value reaches the goal; unknown ones do not."""
        if math.isnan(self.bound):
            return ~np.isnan(values)
        return values > self.bound if self.larger else values < self.bound


def parse_goals(texts: Sequence[str]) -> list[Goal]:
    """Parse goals as users write them.

    Raises:
        InputError: there is no goal, one cannot be parsed, or two have the same name.
    """
    if not texts:
        raise InputError(f"is missing; {_FORMS}", argument="goals")
    goals = [parse_goal(text) for text in texts]
    name, count = Counter(goal.name for goal in goals).most_common(1)[0]
    if count > 1:
        raise InputError(f"two goals are of {name}; keep one", argument="goals")
    return goals


def parse_goal(text: str) -> Goal:
    """Parse one goal, of any name.

    Raises:
        InputError: it is no goal.
    """
    if unbounded := _UNBOUNDED.fullmatch(text.strip()):
        return Goal(name=unbounded[2], larger=unbounded[1] == "max")
    bounded = _BOUNDED.fullmatch(text.strip())
    if bounded:
        try:
            bound = float(bounded[3])
        except ValueError:
            bound = math.nan
        if math.isfinite(bound):
            return Goal(name=bounded[1], larger=bounded[2] == ">", bound=bound)
    if re.fullmatch(_NAME, text.strip()):
        name = text.strip()
        problem = f"{name!r} has no direction; write min:{name} or max:{name}, or a bound"
        raise InputError(problem, argument="goals")
    raise InputError(f"{text!r} is no goal; {_FORMS}", argument="goals")


def on_front(cost: Reals) -> Bools:
    """Find the candidates that no other one surpasses.

    One candidate surpasses another if no cost of it is greater and one is smaller. Candidates with
    an infinite cost are not on the front.

    Args:
        cost: Costs of n candidates, smaller is better, shape (n, k).

    Returns:
        Whether each is on the front, shape (n,).
    """
    front: Bools = (surpassed_by(cost) == 0) & np.isfinite(cost).all(axis=1)
    return front


def surpassed_by(cost: Reals) -> Ints:
    """Count the candidates that surpass each one; costs as for `on_front`, shape (n,)."""
    counts = np.zeros(len(cost), np.int64)
    for number, of_one in enumerate(cost):
        surpasses = (cost <= of_one).all(axis=1) & (cost < of_one).any(axis=1)
        counts[number] = surpasses.sum()
    return counts
