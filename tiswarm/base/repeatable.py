"""Code of plug-ins whose results have to follow from the seed: random generators around it.

A generator that outlives a call gives each call other numbers, so the same seed has other results
in a second run, on other workers and in another batch. Such are the generators of numpy and Python
themselves, those at the top of a plug-in, and those of its classes. One without a seed never
repeats. The module changes neither numbers nor generators; it notices that one was used.
"""

import pickle
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from inspect import unwrap
from typing import Any

import numpy as np

_REMEDY = (
    "draw from step.uniform in choose, members.uniform in act, else from "
    "numpy.random.default_rng(seed) in the call"
)


@contextmanager
def watched(code: Callable[..., Any], owner: object = None) -> Iterator[None]:
    """Refuse random numbers in the block that would not repeat.

    Args:
        code: Function of the plug-in that the block calls.
        owner: Object whose method it is.

    Raises:
        ValueError: a generator that outlives the call was used, or one without a seed was made.
    """
    names: dict[str, Any] = getattr(unwrap(code), "__globals__", {})
    generators = dict(_generators(names))
    for kind in type(owner).__mro__:
        generators |= dict(_generators(vars(kind)))
    before = {name: _state_of(generator) for name, generator in generators.items()}
    with _seeds_demanded(names):
        yield
    for name, generator in generators.items():
        if _state_of(generator) != before[name]:
            raise ValueError(f"{name} was used, whose numbers do not repeat; {_REMEDY}")


def _generators(names: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the generators that outlive a call, by name."""
    yield "the generator of numpy.random", np.random.mtrand._rand  # noqa: SLF001 - it has no other name
    yield "the generator of random", random._inst  # noqa: SLF001
    kinds = (np.random.Generator, np.random.RandomState, random.Random)
    for name, value in list(names.items()):
        if isinstance(value, kinds):
            yield f"the generator {name}", value


def _state_of(generator: Any) -> bytes:  # noqa: ANN401 - of three kinds
    """Return something that changes with each draw."""
    if isinstance(generator, random.Random):
        return pickle.dumps(generator.getstate())
    if isinstance(generator, np.random.RandomState):
        return pickle.dumps(generator.get_state(legacy=False))
    return pickle.dumps(generator.bit_generator.state)


@contextmanager
def _seeds_demanded(names: dict[str, Any]) -> Iterator[None]:
    """Let `default_rng` demand a seed, by whichever name the plug-in calls it."""
    original = np.random.default_rng

    def default_rng(seed: Any = None) -> np.random.Generator:  # noqa: ANN401 - as the original
        if seed is None:
            raise ValueError(f"default_rng() without a seed does not repeat; {_REMEDY}")
        return original(seed)

    aliases = [name for name, value in names.items() if value is original]
    np.random.default_rng = default_rng
    names.update(dict.fromkeys(aliases, default_rng))
    try:
        yield
    finally:
        np.random.default_rng = original
        names.update(dict.fromkeys(aliases, original))
