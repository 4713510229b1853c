"""Who hears a transmission between robots, and channels of users.

In each round a channel decides about all transmissions of the round at once. Those of the package
lose a share of transmissions, each by itself or in bursts. In a burst the link from one robot to
another is bad for some rounds (Gilbert, Bell System Technical Journal 39, 1960): with a share b of
bad rounds and bursts of m rounds, a bad link becomes good with 1/m a round, and a good one bad with
b / (m (1 - b)). By radio, transmissions in the same slot of a round collide.

A plug-in registers a channel, which scenarios choose as `localization.channel`; all robots are in
reach of it, or those that measure ranges:

    @tiswarm.channel("fades")
    def hear(air, settings):
        return air.chance >= 0.2  # shape (P,)
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.plugins import call_plugin
from tiswarm.base.registry import register


class Air(NamedTuple):
    """What is transmitted in a round: P pairs of a transmission and a robot in reach of it."""

    round: int
    """Number of the round, from 1."""

    sender: Ints
    """Robot that transmits, shape (P,)."""

    listener: Ints
    """Robot in reach, shape (P,)."""

    size: Ints
    """Bytes of the transmission, shape (P,)."""

    chance: Reals
    """Draw of each pair, uniform from 0 to 1, shape (P,)."""

    own_chance: Reals
    """Draw of each transmission, which its pairs share, shape (P,)."""

    is_answer: bool
    """Whether these are acknowledgments, each in reach of one robot and in a time of its own."""


Hear = Callable[[Air], Bools]
"""Returns which listeners hear the transmission, shape (P,)."""

_Hears = TypeVar("_Hears", bound=Callable[..., Any])


class Lossy:
    """A channel of the package: it loses transmissions by chance, in bursts, and by collisions."""

    def __init__(self, loss: float, burst: float | None = None, slots: int | None = None) -> None:
        """Begin with good and bad links in the shares that they have in the long run.

        Args:
            loss: Share of transmissions that are lost, without collisions [1].
            burst: Mean rounds that a link stays bad; None where each loss is by itself.
            slots: Slots of a round; each transmission takes one by chance. None where
                nothing collides.
        """
        self._loss, self._slots = loss, slots
        # What is left after a round of the difference from the long run.
        self._kept = 0.0 if burst is None else 1.0 - 1.0 / (burst * (1.0 - loss))
        self._links: dict[tuple[int, int], tuple[float, bool]] = {}

    def hear(self, air: Air) -> Bools:
        """Decide which listeners hear a transmission."""
        heard = air.chance >= self._loss
        if self._kept and self._loss:
            heard = self._outside_bursts(air)
        if self._slots is None or air.is_answer:
            return heard
        return heard & _is_alone(air, self._slots)

    def _outside_bursts(self, air: Air) -> Bools:
        """Let links become good and bad, and return which are good."""
        good = np.ones(len(air.chance), np.bool_)
        pairs = zip(air.sender.tolist(), air.listener.tolist(), air.chance.tolist(), strict=True)
        for pair, (sender, listener, chance) in enumerate(pairs):
            last, was_bad = self._links.get((sender, listener), (-math.inf, False))
            kept = self._kept ** (air.round - last)
            is_bad = chance < self._loss + (was_bad - self._loss) * kept
            self._links[sender, listener] = air.round, is_bad
            good[pair] = not is_bad
        return good


def _is_alone(air: Air, slots: int) -> Bools:
    """Return which transmissions are alone in their slot where the listener is.

    A robot that transmits in a slot hears no other in it.
    """
    slot = np.floor(air.own_chance * slots)
    apart = np.column_stack([air.listener, slot])
    # All pairs of a transmission have one sender and one draw.
    sent = np.unique(np.column_stack([air.sender, slot, air.own_chance]), axis=0)[:, :2]
    _, group, count = np.unique(
        np.concatenate([apart, sent]), axis=0, return_inverse=True, return_counts=True
    )
    alone: Bools = count[group.ravel()[: len(apart)]] == 1
    return alone


def lossy(settings: Any) -> Callable[..., Bools]:  # noqa: ANN401 - of `distributed`
    """Return a channel of the package, by settings of `distributed`."""
    channel = Lossy(settings.loss, settings.burst, settings.slots)
    return lambda *arrays: channel.hear(Air(*arrays))


def channel(name: str) -> Callable[[_Hears], _Hears]:
    """Register a function as a channel, which scenarios choose as `localization.channel`.

    The function takes an `Air`, and the settings of `distributed`: `loss` and the others mean what
    it makes of them. It returns which listeners hear, shape (P,). Its draws should be those of the
    `Air`, so that results repeat.

    Args:
        name: Name of the channel.

    Raises:
        InputError: the name is taken.
    """

    def add(hear: _Hears) -> _Hears:
        def checked(settings: Any) -> Callable[..., Bools]:  # noqa: ANN401 - of `distributed`
            return lambda *arrays: _heard(name, hear, Air(*arrays), settings)

        register("channel", name, checked, hear)
        return hear

    return add


def _heard(name: str, hear: Callable[..., Any], air: Air, settings: Any) -> Bools:  # noqa: ANN401
    """Call a function of a plug-in, and check what it returns.

    Raises:
        PluginError: it failed, or returned something else.
    """
    heard: Bools = call_plugin(
        "channel", name,
        lambda: np.asarray(hear(air, settings)),
        lambda returned: _fault(returned, air.sender.shape),
        repeats=hear,
    )  # fmt: skip
    return heard


def _fault(heard: NDArray[Any], shape: tuple[int, ...]) -> str:
    """Say what is wrong with what a channel returned; empty if nothing is."""
    if heard.shape == shape and heard.dtype == np.bool_:
        return ""
    return f"{heard.dtype} of shape {heard.shape}; return bool of shape {shape}"
