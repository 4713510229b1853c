"""Short names for types of signatures.

`help` and `inspect.signature` show a TypeAliasType by its name, and other aliases in full.
"""

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if sys.version_info >= (3, 12):
    from typing import TypeAliasType
else:
    from typing_extensions import TypeAliasType

Reals = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
AnyInts = NDArray[np.integer]
AnyReals = NDArray[np.floating]

Array = TypeAliasType("Array", ArrayLike)
"""Array, or what makes one."""

PerRobot = TypeAliasType("PerRobot", ArrayLike | None)
"""Numbers of each robot, or nothing."""

PerStep = TypeAliasType("PerStep", ArrayLike | None)
"""One number, one for each step, or nothing."""

Gain = TypeAliasType("Gain", float | None)
"""Gain of a force, or nothing."""

Length = TypeAliasType("Length", float | None)
"""Length, or nothing."""

UserFunction = TypeAliasType("UserFunction", Callable[..., Any] | None)
"""Function of a user for kernels, or nothing."""

Parameters = TypeAliasType("Parameters", Mapping[str, ArrayLike] | None)
"""Numbers that functions of users ask for by name, or nothing."""
