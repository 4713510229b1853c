"""Settings of a study of the engine alone: swarms that move by a force and an integrator.

Nothing is sensed or localized: a case is a run of `tiswarm.relax`.
"""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.errors import did_you_mean
from tiswarm.base.params import STRICT
from tiswarm.base.sections import NameOf, SendsPlugins, mistake_at
from tiswarm.localization.settings import MethodParams

_STEP_S = 3e-7
"""Processor time of a step of a robot, neighbor lists included [s]."""

_Length = Annotated[float, Field(gt=0.0)]
_Part = Annotated[float, Field(ge=0.0)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Start:
    """Where robots are at first: on a cubic lattice."""

    pitch: _Length = 2.9
    """Distance between places of the lattice [R]."""

    jitter: _Part = 1.0
    """Largest shift of a robot from its place along each axis [R]."""

    turned: bool = True
    """Whether orientations are random."""

    contact_band: _Part = 0.16
    """Docks of two robots are connected if their distance differs from D by this at most [R]; 0
    connects none."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Trajectory:
    """Positions that a case stores on the way."""

    every: Annotated[int, Field(ge=1)] = 20
    """Steps between two stored positions; the last step is stored, too."""

    robots: Annotated[int, Field(ge=1)] = 1000
    """Robots that are stored at most: all, or as many at equal distances of their numbers."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RelaxParams(MethodParams, SendsPlugins):
    """The swarm step: every robot at once, moved by the forces on its docks."""

    method: Literal["relax"] = "relax"
    """Name of the method."""

    steps: Annotated[int, Field(ge=1, le=10_000_000)] = 200
    """Steps of each robot."""

    force: Annotated[str, NameOf("force")] = "contact"
    """Force between docks: Eqs. (1) and (2) (contact), or Lennard-Jones. Plug-ins add forces."""

    integrator: Annotated[str, NameOf("integrator")] = "first-order"
    """What makes a step of a force: the force itself (first-order), Verlet or Langevin. Plug-ins
    add integrators."""

    parameters: dict[str, float] = Field(default_factory=dict)
    """Numbers that force and integrator ask for, by name; those with a default may be left out."""

    cutoff: _Length | None = None
    """Distance at which the force between docks that are not connected ends [R]; D if null."""

    max_step: _Length | None = None
    """Longest step of a robot [R]; any if null."""

    body: Literal["robot", "ball"] = "robot"
    """Docks of a robot: those of the section `robot`, or one at its center, which makes it a ball
    of radius R."""

    settled_below: _Length = 1e-3
    """A swarm has settled if the longest last step of a robot is shorter than this [R]."""

    start: Start = Start()
    """Where robots are at first."""

    trajectory: Trajectory | None = Trajectory()
    """Positions that a case stores on the way; none if null."""

    def __post_init__(self) -> None:
        """Refuse numbers that neither function asks for.

        Raises:
            ValidationError: there is such a number, or a cutoff of the engine's own force.
        """
        from tiswarm.engine.laws import in_place_of  # noqa: PLC0415 - slow to import

        asked = self._numbers
        functions = f"{self.force} and {self.integrator}"
        for name in self.parameters:
            if name not in asked:
                meant = did_you_mean(name, [*asked]) or f"; they ask for {', '.join(asked)}"
                problem = f"{functions} have no such number{meant}"
                raise mistake_at(("parameters", name), problem)
        if self.cutoff is not None and in_place_of("force", self.force) is None:
            problem = f"{self.force} ends at D; leave it out, or choose another force"
            raise mistake_at(("cutoff",), problem)

    @property
    def _numbers(self) -> Mapping[str, float | None]:
        """Numbers that force and integrator ask for, with their defaults."""
        from tiswarm.engine.laws import numbers_of  # noqa: PLC0415 - slow to import

        return numbers_of(self.force, self.integrator)

    @property
    def lacks(self) -> tuple[str, ...]:
        """Key of a number without a default that is not given; empty if there is none."""
        for name, default in self._numbers.items():
            if default is None and name not in self.parameters:
                return "parameters", name
        return ()

    @property
    def used_cues(self) -> tuple[str, ...]:
        """What of a log is used: there is none."""
        return ()

    @property
    def places_robots(self) -> bool:
        """Whether it estimates positions: never."""
        return False

    @property
    def runs_engine(self) -> bool:
        """Whether cases are runs of the engine: always."""
        return True

    @property
    def is_parallel(self) -> bool:
        """Whether it runs on the device that a user chooses: always."""
        return True

    def seconds(self, robots: int) -> float:
        """Estimate the processor time of one swarm [s]."""
        return _STEP_S * robots * self.steps
