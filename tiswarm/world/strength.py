"""Strength of docks: which load of a contact counts, and how much of it a contact bears.

A contact whose load is over its strength breaks, the worst of a structure first; then loads are
solved again, until every contact holds. Robots that nothing ties to the ground then fall. A contact
that breaks loses its hold alone: robots that other contacts hold stay where they are.

A law is a function of the loads of all contacts, see `mechanics.ContactLoads`, to the one that may
not exceed `limit`. A plug-in adds one:

    @tiswarm.strength("peel")
    def peel(loads):
        return loads.axial + 2.0 * loads.bending  # shape (C,)

Loads are in weights of a dock W and R. With the mass m of a robot of n docks, W = m g / n.
"""

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.aliases import AnyInts, Reals
from tiswarm.base.params import STRICT, UNLESS_SET
from tiswarm.base.plugins import call_plugin
from tiswarm.base.registry import get, register
from tiswarm.base.sections import NameOf, SendsPlugins
from tiswarm.compute.math import normal
from tiswarm.world.mechanics import GRAVITY, ContactLoads

_MM = 1e-3
"""A millimeter [m]."""

_Law = TypeVar("_Law", bound=Callable[..., Any])


class _Unit(NamedTuple):
    """Unit of a limit: a force, over or times lengths."""

    name: str
    """Name of the unit for robots that have a mass."""

    newtons: float
    """Size of it in N m^lengths."""

    lengths: int
    """Power of the length in it."""


_UNITS: Mapping[str, _Unit] = {
    "tension": _Unit("N", 1.0, 0),
    "shear": _Unit("N", 1.0, 0),
    "bending": _Unit("N m", 1.0, 1),
    "von-mises": _Unit("MPa", 1e6, -2),
}
"""Unit of the limit of each law of the package, for robots that have a mass."""


class LoadUnit(NamedTuple):
    """Unit of a load, for robots of one kind."""

    name: str
    """Name, such as N m; W is the weight of a dock."""

    size: float
    """A load of 1, in weights of a dock and R, in this unit."""

    @property
    def suffix(self) -> str:
        """The unit at the end of a column's name, such as N_m or W_per_R2."""
        return self.name.replace(" / ", "_per_").replace(" ", "_").replace("^", "")


class LoadUnits(NamedTuple):
    """Units of the loads of contacts."""

    force: LoadUnit
    moment: LoadUnit
    stress: LoadUnit

    @property
    def of_loads(self) -> dict[str, LoadUnit]:
        """The unit of each load of contacts, by its name in `ContactLoads`."""
        units = (self.force, self.force, self.moment, self.moment, self.stress)
        return dict(zip(ContactLoads._fields, units, strict=True))


WEIGHTS = LoadUnits(LoadUnit("W", 1.0), LoadUnit("W R", 1.0), LoadUnit("W / R^2", 1.0))
"""Units of robots without a mass: weight of a dock, and R."""


def tension(loads: ContactLoads) -> Reals:
    """Return the pull along each contact [weight of a dock], 0 where docks press, shape (C,)."""
    return np.maximum(loads.axial, 0.0)


def shear(loads: ContactLoads) -> Reals:
    """Return the force across each contact [weight of a dock], shape (C,)."""
    return loads.shear


def bending(loads: ContactLoads) -> Reals:
    """Return the moment that bends each contact [weight of a dock times R], shape (C,)."""
    return loads.bending


def von_mises(loads: ContactLoads) -> Reals:
    """Return the largest von Mises stress of each contact [weight of a dock / R^2], shape (C,)."""
    return loads.stress


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StrengthParams(SendsPlugins):
    """Load from which a contact, of two docks or of a dock with the ground, breaks."""

    law: Annotated[str, NameOf("strength")] = "von-mises"
    """Which load counts: the pull along a contact (tension), the force across it (shear), the
    moment that bends it (bending), or the largest von Mises stress in it. Plug-ins add laws."""

    limit: Annotated[float, Field(gt=0.0)]
    """Load from which a contact breaks. In weights of a dock (tension, shear), these times R
    (bending) or over R^2 (von-mises); with `robot_mass_kg` in N, N m or MPa."""

    scatter: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Standard deviation of the logarithm of the strength of a contact [1], drawn for each."""

    robot_mass_kg: Annotated[float | None, UNLESS_SET, Field(gt=0.0)] = None
    """Mass of a robot [kg]; with it, `limit` is in SI units."""

    radius_mm: Annotated[float | None, UNLESS_SET, Field(gt=0.0)] = None
    """Radius of a dock, R [mm]; goes with `robot_mass_kg` for bending and von-mises."""

    def __post_init__(self) -> None:
        """Refuse a limit whose unit is not given.

        Raises:
            ValueError: it lacks a mass or a radius, or has one that says nothing.
        """
        unit = _UNITS.get(self.law)
        if self.robot_mass_kg is None:
            if self.radius_mm is not None:
                raise ValueError("radius_mm goes with robot_mass_kg; give both, or neither")
            return
        if unit is None:
            raise ValueError(
                f"the limit of {self.law} is in weights of a dock and R; remove robot_mass_kg"
            )
        if unit.lengths and self.radius_mm is None:
            raise ValueError(f"the limit of {self.law} is in {unit.name}; add radius_mm")
        if not unit.lengths and self.radius_mm is not None:
            raise ValueError(f"the limit of {self.law} is in {unit.name}; remove radius_mm")

    def limit_for(self, docks: int) -> float:
        """Return `limit` in weights of a dock and R, for robots of so many docks."""
        if self.robot_mass_kg is None:
            return self.limit
        unit = _UNITS[self.law]
        return self.limit * unit.newtons / self._newtons(unit.lengths, docks)

    def units_for(self, docks: int) -> LoadUnits:
        """Return the units of `limit`, in which users read loads of robots of so many docks.

        Robots that have a mass but no radius have forces in N, and lengths in R.
        """
        if self.robot_mass_kg is None:
            return WEIGHTS
        if self.radius_mm is None:
            weight = self._newtons(0, docks)
            names = (unit.name.replace("W", "N") for unit in WEIGHTS)
            return LoadUnits(*(LoadUnit(name, weight) for name in names))
        return LoadUnits(
            *(
                LoadUnit(unit.name, self._newtons(unit.lengths, docks) / unit.newtons)
                for unit in (_UNITS["tension"], _UNITS["bending"], _UNITS["von-mises"])
            )
        )

    def _newtons(self, lengths: int, docks: int) -> float:
        """Return the weight of a dock times a power of R [N m^lengths]; R is 1 mm if not stated."""
        weight = (self.robot_mass_kg or math.nan) * GRAVITY / docks
        radius = _MM * (self.radius_mm or 1.0)
        return weight * radius**lengths

    def strength(self, seed: int, ends: AnyInts, docks: int) -> Reals:
        """Draw the load from which contacts break [weights of a dock and R], shape (C,).

        Args:
            seed: Seed of the structure.
            ends: Rows of (dock, dock or -1 for the ground), in which dock k of robot i of n docks
                has the number n i + k, shape (C, 2). A draw depends on the seed and these alone.
            docks: n.
        """
        limit = self.limit_for(docks)
        if self.scatter == 0.0:
            return np.full(len(ends), limit)
        lower = 1 + ends.min(axis=1)  # 0 for the ground
        return limit * np.exp(self.scatter * normal(seed, "strength", ends.max(axis=1), lower))

    def used(self, seed: int, ends: AnyInts, loads: ContactLoads, docks: int) -> Reals:
        """Return the load of each contact in parts of its strength [1], shape (C,).

        A contact whose load is 0 or less by the law bears nothing: 0. Arguments are those of
        `strength`, and the contacts' loads.
        """
        demand: Reals = get("strength", self.law)(loads)
        demand = np.where(demand > 0.0, demand, 0.0)  # -0 would be a margin of minus infinity
        return demand / self.strength(seed, ends, docks)


def strength(name: str) -> Callable[[_Law], _Law]:
    """Register a function as a law of strength, which scenarios choose as `structure.strength.law`.

    The function takes the loads of C contacts, `axial` (positive for a pull), `shear`, `bending`,
    `torsion` and `stress`, and returns the one that may not exceed `limit`, shape (C,). A contact
    with a load of 0 or less, such as one that docks press, does not break and has no margin. A load
    that is not finite is refused.

    Args:
        name: Name of the law.

    Raises:
        InputError: the name is taken, or this is no function.
    """

    def add(law: _Law) -> _Law:
        def checked(loads: ContactLoads) -> Reals:
            shape = loads.axial.shape
            demand: Reals = call_plugin(
                "strength",
                name,
                lambda: np.asarray(law(loads)),
                lambda returned: _fault(returned, shape),
                repeats=law,
            )
            return demand.astype(np.float64)

        register("strength", name, checked, law)
        return law

    return add


def _fault(demand: NDArray[Any], shape: tuple[int, ...]) -> str:
    """Say what is wrong with what a law returned; empty if nothing is."""
    if demand.shape != shape or demand.dtype.kind not in "iuf":
        return f"{demand.dtype} of shape {demand.shape}; return numbers of shape {shape}"
    if not np.isfinite(demand).all():
        return "a load that is not finite; return finite numbers"
    return ""
