"""Settings of localization: the cues that methods share, and those of the methods of the core."""

from dataclasses import fields
from typing import Annotated, ClassVar, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.params import STRICT, UNLESS_SET
from tiswarm.localization.cost import EXTENSION
from tiswarm.measurements.cues import CUES, cue_names

MOST_STEPS = 3000
"""Steps in which structures of up to `LARGE` robots are annealed where fewer do not converge."""

LARGE = 3000
"""Structures of more robots than this are annealed fewer times, quicker, and not refined."""

_Axes = Annotated[int, Field(ge=1, le=64)]
_Sd = Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Cues:
    """Cues that localization uses; each counts as far as the log has it.

    There is a switch for each cue that has one in the table `tiswarm.measurements.cues.CUES`.
    Fields carry their text as a description, for the JSON Schema does not find the docstrings of a
    base class.
    """

    contacts: Annotated[bool, Field(description="Docks that touch at the end are D apart.")] = True

    non_overlap: Annotated[bool, Field(description="All other docks are D apart or farther.")] = (
        True
    )

    height: Annotated[bool, Field(description="Robots are as high as their flips imply.")] = True

    ground: Annotated[
        bool, Field(description="A dock on flat ground is one dock radius above it.")
    ] = True

    walk_contacts: Annotated[
        bool, Field(description="Contacts of earlier stances count too, carried on by flips.")
    ] = True

    odometry: Annotated[
        bool, Field(description="Robots that know their spawn went as far as their flips say.")
    ] = True

    plane: Annotated[
        bool, Field(description="Planar robots are in the vertical plane of the anchor.")
    ] = True

    fixes: Annotated[
        bool, Field(description="Coordinates that a beacon or camera measured count.")
    ] = True

    ranges: Annotated[bool, Field(description="Measured distances of centers count.")] = True

    directions: Annotated[bool, Field(description="Measured directions of contacts count.")] = True

    touches: Annotated[
        bool, Field(description="Contacts whose docks are unknown count; methods must find these.")
    ] = True

    displacements: Annotated[
        bool, Field(description="Measured vectors between the centers of two robots count.")
    ] = True


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CuesOfNamedDocks(Cues):
    """Cues of methods that cannot find the docks of a contact."""

    touches: Literal[False] = False
    """Contacts whose docks are unknown do not count: only `joint` and `least-squares` find them."""


SWITCHES = tuple(field.name for field in fields(Cues))
"""Cues that settings have a switch for."""

DOCKS_UNKNOWN = tuple(cue.name for cue in CUES if not cue.names_docks)
"""Cues that only methods can use that find the docks of their rows."""


def all_cues() -> tuple[str, ...]:
    """List those, and the ones that every method uses."""
    return tuple(dict.fromkeys((*SWITCHES, *cue_names())))


class MethodParams:
    """Settings of a localization method, and what its settings decide before it is loaded."""

    module: ClassVar[str]
    """Module of the method, see `tiswarm.localization.methods`."""

    calls: ClassVar["type[MethodParams] | None"] = None
    """Settings of another method that this one calls, by the door to all of them."""

    method: str
    """Name of the method."""

    @property
    def used_cues(self) -> tuple[str, ...]:
        """Names of the cues that are used of a log, as far as it has them: all."""
        return all_cues()

    @property
    def joining(self) -> str:
        """Class, of its module, that places robots as they join; empty if it needs all."""
        return ""

    @property
    def title(self) -> str:
        """Name of the method, and its schedule unless robots move in join order."""
        return self.method

    @property
    def is_parallel(self) -> bool:
        """Whether it runs on the device that a user chooses; others run on the processor in f64."""
        return False

    @property
    def places_robots(self) -> bool:
        """Whether it estimates positions: all but `none` do."""
        return True

    @property
    def lacks(self) -> tuple[str, ...]:
        """Key of a setting that no point of a sweep may lack; empty if none is missing."""
        return ()

    @property
    def runs_engine(self) -> bool:
        """Whether cases are runs of the engine, which have no structure: those of `relax` alone."""
        return False

    def seconds(self, robots: int) -> float:
        """Estimate the processor time of one structure, on one core of a server of 2023 [s]."""
        return _ROBOT_S * robots


_ROBOT_S = 0.01
"""Processor time of a robot in a method that states no other [s]."""

_ITERATION_S = 1.3e-6
"""Processor time of an iteration of a robot in Algorithm 1 [s]."""

_TOGETHER_S = 5e-7
"""Processor time of a step of a robot under the schedule `together` [s]."""

_CHAIN_STEP_S = 4e-7
"""Processor time of a step of a robot in one chain [s]; of 40,000 robots each takes twice that."""

_ONE_BY_ONE = (
    "back_propagation",
    "stop_error",
    "height_order",
    "neighbor_repulsion",
)
"""Settings of `virtual-force` that have no meaning where robots move together."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CueParams(MethodParams):
    """Settings of a method that can do without any of the cues.

    Fields of base classes carry their text as a description, as those of `Cues`.
    """

    cues: Annotated[Cues, Field(description="Cues in use, each of them on or off.")] = Cues()

    flip_axes: Annotated[
        _Axes | None,
        UNLESS_SET,
        Field(description="Axes of a dock to fit flips to; if null, none are fitted."),
    ] = None

    @property
    def used_cues(self) -> tuple[str, ...]:
        """What of the log is used: every cue without a switch, and those whose switch is on."""
        return tuple(cue for cue in all_cues() if getattr(self.cues, cue, True))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ChiSquareParams(CueParams):
    """What the chi-square of all measurements is made of, beside what a log states.

    How much each cue counts follows from the noise that the log states.
    """

    robust: Annotated[
        bool, Field(description="Let measurements that disagree with all others give way.")
    ] = True

    solve_yaw: Annotated[
        bool, Field(description="Solve for each robot's bias of yaw if the log states its sd.")
    ] = True

    seed: Annotated[int, Field(ge=0, lt=2**31, description="Seed of all starts.")] = 0

    contact_sd: Annotated[_Sd, Field(description="Error of D of docks in contact [R].")] = 0.006

    height_sd: Annotated[
        _Sd, Field(description="Error of heights and grounds beside that of orientations [R].")
    ] = 0.01

    spawn_sd: Annotated[
        _Sd, Field(description="Error of coordinates of spawns, if the log states none [R].")
    ] = 0.2

    def refines(self, robots: int) -> bool:  # noqa: ARG002 - `joint` looks at it
        """Whether to move estimates of a structure of so many robots to a minimum."""
        return True


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BackPropagation:
    """Rounds in which robots that have been placed learn from those that joined after them.

    In a round docks in contact that are nearer than D part as firmly as others approach. The
    defaults are a compromise for structures of the seeds 1000 to 1059, settled or not: with a gain
    of .5 settled towers come out worse than without any round.
    """

    every: Annotated[int, Field(ge=1)] = 10
    """Joins between two rounds; the last join is followed by one too."""

    recent: Annotated[int, Field(ge=1)] | None = None
    """Robots that a round moves, those that joined last, as the paper proposes; all if null."""

    sweeps: Annotated[int, Field(ge=0, le=1_000_000)] = 2000
    """Steps that every robot takes in a round; 0 switches rounds off."""

    gain: Annotated[float, Field(gt=0.0, le=1.0)] = 0.35
    """Share of the forces that a step in a round follows; whole ones make robots that hold on to
    many others overshoot."""

    repulsion_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.025
    """1 - alpha_t as a round begins; it falls to 0 linearly. At full strength repulsion would
    undo what is right already."""

    def steps(self, robots: int) -> float:
        """Count the steps of a robot in all rounds, in the mean of so many robots."""
        after = [*range(self.every, robots, self.every), robots]  # so many joins
        moved = sum(min(joins, self.recent or robots) for joins in after)
        return float(self.sweeps * moved / robots)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Together:
    """How all robots step at once, from where chains of contacts lead, under the schedule together.

    Connected docks nearer than D part as firmly as others approach. Robots have inertia, by which
    an error spreads over many robots. The defaults are for structures of the seeds 100,000 to
    100,011 with 100 to 10,000 robots; `docs/notes/measurements.md` has errors.
    """

    steps: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Steps of every robot; 700 if null, and in proportion to the cube root of N beyond 1,000
    robots, since an error has farther to go."""

    gain: Annotated[float, Field(gt=0.0, le=1.0)] = 0.6
    """Share of the forces that a step follows, divided by the number of the robot's contacts."""

    momentum: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    """Share of its last step that a robot takes again; 1 - 10.5 / steps if null, so that motion
    decays by the same factor in each structure."""

    max_step: Annotated[float, Field(gt=0.0)] = 0.55
    """A robot moves no farther than this in a step [R]; with long steps robots scatter."""

    repulsion_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.045
    """1 - alpha_t at the first step; it falls to 0 linearly."""

    def pace(self, robots: int) -> tuple[int, float]:
        """Choose the steps and the momentum of a structure of so many robots."""
        steps = self.steps or round(700 * max(1.0, robots / 1_000) ** (1.0 / 3.0))
        return steps, max(0.0, 1.0 - 10.5 / steps) if self.momentum is None else self.momentum


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualForceParams(MethodParams):
    """Gains of Eqs. (1)-(3) and the schedule that applies them.

    Gains must not be fitted on the runs they are reported on. The defaults are those of
    `docs/fits/virtual-force.json`, to two digits: found by `benchmarks.tuning` on towers and
    cantilevers of the seeds 1000 to 1011, under all conditions of `scenarios/paper.yaml`.
    """

    module: ClassVar = "tiswarm.localization.virtual_force.method"

    method: Literal["virtual-force"] = "virtual-force"
    """Name of the method."""

    schedule: Literal["join-order", "together"] = "join-order"
    """Who moves: each robot after those that joined before it, as in Algorithm 1, or all robots at
    once, which uses all cores for one large structure. Together, robots start where chains of
    contacts lead, and the trace has 31 frames; what only Algorithm 1 has does not count then:
    `initial_offset`, `initial_offset_axis`, `iterations`, `max_step` and `trace_every`."""

    together: Together = Together()
    """Steps under the schedule `together`."""

    z_correction: bool = True
    """Pull each robot toward the height that its flips imply, Eq. (3)."""

    ground: bool = True
    """Pull each robot that stands on flat ground toward the height that this implies, Eq. (3)."""

    height_order: Literal["with-docks", "after-docks"] = "with-docks"
    """Whether Eq. (3) adds to the forces at the docks, or moves the robot after they did, in a step
    that nothing caps, as in the listing of Algorithm 1."""

    undocked_repulsion: bool = True
    """Push apart docks that overlap though they are not in contact, Eq. (2)."""

    neighbor_repulsion: bool = False
    """Without `undocked_repulsion`, push apart such docks of robots in contact all the same, as
    the listing of Algorithm 1 does; its text says that robots know nothing of them then."""

    back_propagation: BackPropagation | None = None
    """Correct earlier robots by later ones, the paper's proposal for future work; off if null."""

    attraction_gain: Annotated[float, Field(ge=0.0)] = 0.84
    """A in Eq. (1): step per unit of stretch [1]."""

    repulsion_gain: Annotated[float, Field(ge=0.0)] = 120.0
    """B in Eqs. (1) and (2): step per unit of overlap to the fourth [R^-3]."""

    height_gain: Annotated[float, Field(ge=0.0)] = 0.47
    """k_z in Eq. (3): step per unit of height missing [1]."""

    initial_offset: float = 6.3
    """s in Algorithm 1: how far a robot starts from the mean of its located neighbors, or from the
    anchor if it has none [R]."""

    initial_offset_axis: Literal["world", "body"] = "world"
    """Direction of that offset: world up, or the robot's own z axis."""

    max_step: Annotated[float, Field(gt=0.0)] = 2.1
    """A robot moves no farther than this in one iteration [R]; our addition, without which
    useful gains diverge."""

    iterations: Annotated[int, Field(ge=1, le=1_000_000)] = 300
    """T: most refinement steps of each robot."""

    stop_error: Annotated[float, Field(ge=0.0)] = 0.0
    """A robot stops early once its misfit is below this [R]: the root mean square by which its
    contacts miss D and its center its height; 0 never stops it."""

    trace_every: Annotated[int, Field(ge=1)] = 5
    """The trace keeps every so many iterations, and the last."""

    def __post_init__(self) -> None:
        """Refuse what robots that move together cannot do."""
        if self.schedule == "together":
            usual = {field.name: field.default for field in fields(self)}
            for name in _ONE_BY_ONE:
                if getattr(self, name) != usual[name]:
                    raise ValueError(
                        f"{name} moves robots one by one; remove it, or set schedule to join-order"
                    )

    @property
    def used_cues(self) -> tuple[str, ...]:
        """What of the log is used."""
        chosen = {
            "contacts": True,
            "non_overlap": self.undocked_repulsion,
            "height": self.z_correction,
            "ground": self.ground,
            "plane": True,
            "anchors": True,
        }
        return tuple(cue for cue, is_used in chosen.items() if is_used)

    @property
    def joining(self) -> str:
        """Class that places robots as they join; empty if settings let robots move afterwards."""
        moves_all = self.is_parallel or self.back_propagation is not None
        return "" if moves_all else "Localizer"

    @property
    def title(self) -> str:
        """Name of the method, and its schedule unless robots move in join order."""
        return f"{self.method} {self.schedule}" if self.is_parallel else self.method

    @property
    def is_parallel(self) -> bool:
        """Whether all robots move at once."""
        return self.schedule == "together"

    def seconds(self, robots: int) -> float:
        """Estimate the processor time of one structure [s]."""
        if self.is_parallel:
            return _TOGETHER_S * robots * self.together.pace(robots)[0]
        rounds = self.back_propagation
        steps = self.iterations + (rounds.steps(robots) if rounds else 0.0)
        return _ITERATION_S * robots * steps


@dataclass(frozen=True, kw_only=True, config=STRICT)
class JointParams(ChiSquareParams):
    """Schedule of the annealer that places all robots at once."""

    module: ClassVar = "tiswarm.localization.joint"

    method: Literal["joint"] = "joint"
    """Name of the method."""

    refine: bool | None = None
    """Move the end of each chain to a minimum, and count errors that steps of a walk share once;
    never where a bias of yaw of more than 0.2 rad is to be solved for. Otherwise only the mean of
    the chains is moved, as if errors were independent. If null up to 3,000 robots, beyond which
    the former would take longer than the chains."""

    chains: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Annealings from different starts; their ends, weighed by fit, make the estimate. If null 8,
    or 4 for more than 3,000 robots, where time counts more than the little that others add."""

    steps: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    """Steps of an annealing; in fewer than some 500 robots cannot cool, and may escape. If null
    1,000, and 2 for each robot, up to 3,000, and again in 3,000 if these do not converge; or 2,000
    for more than 3,000 robots, and more beyond 30,000, as N^(3/4), since a whole tower moves ever
    more slowly. Chosen on training structures, see `docs/notes/measurements.md`."""

    hold_steps: Annotated[int, Field(ge=1, le=10_000_000)] = 900
    """Steps at the end temperature, over which positions are averaged."""

    start_sigma: Annotated[float, Field(gt=0.0)] = 0.6
    """Square root of the temperature at which annealing begins: the standard deviation by which
    measurements may be missed then [R]. At least 2 where ranges alone tie robots to each other."""

    end_sigma: Annotated[float, Field(gt=0.0)] | None = None
    """By how much measurements may be missed at the end, the square root of the temperature [R]. If
    null 0.01, or up to 0.025 where they are few or vague."""

    extension_prior: Annotated[float, Field(ge=0.0, le=3.0)] = EXTENSION
    """Prior that robots extend outward: gain in log-likelihood for each R more between the centers
    of two robots in contact [R^-1], shared among the contacts of the robot that has fewer. Robots
    climb as far as they can before they stay; most configurations that fit their measurements are
    folded closer than what they build."""

    @property
    def is_parallel(self) -> bool:
        """Whether chains run on the device that a user chooses: always."""
        return True

    def seconds(self, robots: int) -> float:
        """Estimate the processor time of one structure [s]."""
        steps = (self.steps_for(robots) + self.hold_steps) * (1.0 + robots / 40_000)
        return _CHAIN_STEP_S * robots * self.chains_for(robots) * steps

    def chains_for(self, robots: int) -> int:
        """Annealings of a structure of so many robots."""
        return self.chains or (8 if robots <= LARGE else 4)

    def steps_for(self, robots: int) -> int:
        """Steps of each annealing."""
        many = round(2000 * max(1.0, robots / 30_000) ** 0.75)
        return self.steps or (min(1000 + 2 * robots, MOST_STEPS) if robots <= LARGE else many)

    def refines(self, robots: int) -> bool:
        """Whether to refine what chains of a structure of so many robots come to."""
        return robots <= LARGE if self.refine is None else self.refine


@dataclass(frozen=True, kw_only=True, config=STRICT)
class NoneParams(MethodParams):
    """No localization: structures are grown and measured, and nothing is estimated."""

    method: Literal["none"] = "none"
    """Name of the method."""

    @property
    def used_cues(self) -> tuple[str, ...]:
        """What of the log is used: nothing."""
        return ()

    @property
    def places_robots(self) -> bool:
        """Whether it estimates positions: never."""
        return False

    def seconds(self, robots: int) -> float:  # noqa: ARG002 - nothing is computed
        """Estimate the processor time of one structure [s]: none."""
        return 0.0
