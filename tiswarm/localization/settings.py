"""Settings of localization: cues that methods share, and those of each method."""

from dataclasses import fields, make_dataclass
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.params import STRICT
from tiswarm.measurements.cues import cue_names, switched

LARGE = 3000
"""Structures of more robots than this are annealed fewer times, quicker, and not refined."""

_ONE_BY_ONE = (
    "back_propagation",
    "stop_error",
    "height_order",
    "neighbor_repulsion",
)
"""Settings of `virtual-force` that have no meaning where robots move together."""

_OF_SCHEME = {
    "joiner": ("hops", "robots", "solver", "reach", "growth", "chains", "steps", "start_sigma"),
    "algorithm-1": ("poses", "back_propagation", "undocked_repulsion"),
}
"""Settings of `distributed` that have a meaning in one scheme only."""


SWITCHES = tuple(cue.name for cue in switched())
"""Cues that settings have a switch for."""


DOCKS_UNKNOWN = tuple(cue.name for cue in switched() if cue.docks_unknown)
"""Cues that only `joint` can use: it finds the docks of their rows."""


def all_cues() -> tuple[str, ...]:
    """List those, and the ones that every method uses."""
    return tuple(dict.fromkeys((*SWITCHES, *cue_names())))


_Switches: Any = make_dataclass(
    "_Switches",
    [(cue.name, Annotated[bool, Field(description=cue.switch)], True) for cue in switched()],
    frozen=True,
    kw_only=True,
)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CueParams(_Switches):  # type: ignore[misc]
    """Cues of a method that can do without any of them; each counts as far as the log has it.

    There is a switch for each cue that has one in the table of cues. Fields that are inherited
    carry their text as a description, for the JSON Schema does not find the docstrings of a base
    class.
    """

    @property
    def cues(self) -> tuple[str, ...]:
        """What of the log is used: every cue without a switch, and those whose switch is on."""
        return tuple(cue for cue in all_cues() if getattr(self, cue, True))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ChiSquareParams(CueParams):
    """What the chi-square of all measurements is made of, beside what a log states.

    How much each cue counts follows from the noise that the log states.
    """

    robust: Annotated[
        bool, Field(description="Let measurements that disagree with all others give way.")
    ] = True

    solve_yaw: Annotated[
        bool,
        Field(
            description="Solve for each robot's bias of yaw where the log states one; else it "
            "widens equations."
        ),
    ] = True

    seed: Annotated[
        int, Field(ge=0, lt=2**31, description="Seed of the random numbers of all starts.")
    ] = 0

    contact_sd: Annotated[
        float,
        Field(
            gt=0.0,
            description="How far from D docks that feel each other may be, as a standard deviation "
            "[R].",
        ),
    ] = 0.006

    height_sd: Annotated[
        float,
        Field(
            gt=0.0,
            description="The same of heights and grounds, beside the noise that the log states "
            "[R].",
        ),
    ] = 0.01

    spawn_sd: Annotated[
        float,
        Field(
            gt=0.0,
            description="Standard deviation of each coordinate of a spawn position whose log "
            "states none [R].",
        ),
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


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Together:
    """How all robots step at once, from where chains of contacts lead, under the schedule together.

    Connected docks nearer than D part as firmly as others approach. Robots have inertia, by which
    an error spreads over many robots. The defaults are for structures of the seeds 1000 to 1023
    with 100 robots and 1000 to 1002 with 1,000; `docs/notes/together.md` compares others.
    """

    steps: Annotated[int, Field(ge=1, le=1_000_000)] = 3000
    """Steps of every robot."""

    gain: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03
    """Share of the forces that a step follows, divided by the number of the robot's contacts."""

    momentum: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.995
    """Share of its last step that a robot takes again."""

    repulsion_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.04
    """1 - alpha_t at the first step; it falls to 0 linearly. With twice as much robots scatter."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class VirtualForceParams:
    """Gains of Eqs. (1)-(3) and the schedule that applies them.

    Gains must not be fitted on the runs they are reported on. The defaults are those of
    `docs/fits/virtual-force.json`, to two digits: found by `benchmarks.tuning` on towers and
    cantilevers of the seeds 1000 to 1011, under all conditions of `scenarios/paper.yaml`.
    """

    method: Literal["virtual-force"] = "virtual-force"
    """Name of the method."""

    schedule: Literal["join-order", "together"] = "join-order"
    """Who moves: each robot after those that joined before it, as in Algorithm 1, or all robots at
    once, which uses all cores for one large structure. Together, robots start where chains of
    contacts lead, and the trace has 31 frames; what only Algorithm 1 has does not count then:
    `initial_offset`, `initial_offset_axis`, `iterations` and `trace_every`."""

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
    def cues(self) -> tuple[str, ...]:
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


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LeastSquaresParams(ChiSquareParams):
    """Starts from which the chi-square of all measurements is minimized."""

    method: Literal["least-squares"] = "least-squares"
    """Name of the method."""

    starts: Annotated[int, Field(ge=1, le=1000)] = 4
    """Starts: the positions of `hop-by-hop`, and the same with random errors of its standard
    deviations. Where ranges tie robots, multidimensional scaling adds two more."""

    rounds: Annotated[int, Field(ge=1, le=1000)] = 50
    """Levenberg-Marquardt steps at most from each start."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class JointParams(ChiSquareParams):
    """Schedule of the annealer that places all robots at once."""

    method: Literal["joint"] = "joint"
    """Name of the method."""

    refine: bool | None = None
    """Let errors that equations of walks share count once, by generalized least squares from where
    the chains ended; never where a bias of yaw of more than 0.2 rad is to be solved for. If null
    up to 3,000 robots, beyond which it would take longer than the chains."""

    chains: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Annealings from different starts; the estimate is made of their mean. If null 8,
    or 4 for more than 3,000 robots, where time counts more than the little that others add."""

    steps: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    """Steps of an annealing; in fewer than some 500 robots cannot cool, and may escape. If null
    3,000, or 2,000 for more than 3,000 robots."""

    hold_steps: Annotated[int, Field(ge=1, le=10_000_000)] = 900
    """Steps at the end temperature, over which positions are averaged."""

    start_sigma: Annotated[float, Field(gt=0.0)] = 0.6
    """Square root of the temperature at which annealing begins: the standard deviation by which
    measurements may be missed then [R]. At least 2 where ranges alone tie robots to each other."""

    end_sigma: Annotated[float, Field(gt=0.0)] | None = None
    """Square root of the temperature at which annealing ends [R]. If null 0.01 where measurements
    suffice and are sharp, up to 0.025 where they are fewer than the coordinates by a twentieth, or
    that uncertain."""

    extension_prior: Annotated[float, Field(ge=0.0, le=3.0)] = 1.5
    """Prior that robots extend outward: gain in log-likelihood for each R more between the centers
    of two robots in contact [R^-1], shared among the contacts of the robot that has fewer. Robots
    climb as far as they can before they stay; most configurations that fit their measurements are
    folded closer than what they build."""

    def chains_for(self, robots: int) -> int:
        """Annealings of a structure of so many robots."""
        return self.chains or (8 if robots <= LARGE else 4)

    def steps_for(self, robots: int) -> int:
        """Steps of each annealing."""
        return self.steps or (3000 if robots <= LARGE else 2000)

    def refines(self, robots: int) -> bool:
        """Whether to refine what chains of a structure of so many robots come to."""
        return robots <= LARGE if self.refine is None else self.refine


@dataclass(frozen=True, kw_only=True, config=STRICT)
class OnlineParams(ChiSquareParams):
    """What a tracker does at a join, beside solving for the robots near the one that joined."""

    method: Literal["online"] = "online"
    """Name of the method."""

    touches: Literal[False] = False
    """Touches do not count: only `joint` finds their docks."""

    solve_yaw: Literal[False] = False
    """No bias of yaw is solved for."""

    anneal_growth: Annotated[float, Field(gt=0.0)] = 0.1
    """Growth of the structure after which it is annealed again, in its size at the last time
    [1]."""

    chains: Annotated[int, Field(ge=1, le=1000)] = 4
    """Annealings then, each from the present estimate."""

    steps: Annotated[int, Field(ge=1, le=10_000_000)] = 500
    """Steps of each annealing."""

    hold_steps: Annotated[int, Field(ge=1, le=10_000_000)] = 200
    """Steps at the end temperature, over which positions are averaged."""

    start_sigma: Annotated[float, Field(gt=0.0)] = 0.4
    """Square root of the temperature at which annealing begins [R]: warm enough for mirror images
    of single robots to be tried, and cold enough for the structure to keep its shape."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DistributedParams(ChiSquareParams):
    """What robots send each other to find out where they are, and by which channel.

    A robot computes from its own rows and from what it was sent. By default one robot, the anchor,
    solves for all within `reach` of it, and so for all of a structure of 100.
    """

    method: Literal["distributed"] = "distributed"
    """Name of the method."""

    touches: Literal[False] = False
    """Touches do not count: only `joint` finds their docks."""

    solve_yaw: Literal[False] = False
    """No bias of yaw is solved for."""

    scheme: Literal["joiner", "algorithm-1"] = "joiner"
    """joiner: where a robot joins, one robot asks those nearby for what they measured, solves for
    their positions and sends them the answer. algorithm-1: the paper's, by the defaults of
    `virtual-force`, whose positions are those without losses and rounding."""

    poses: Literal["once", "every-join"] = "every-join"
    """When robots send their poses in `algorithm-1`: once they are placed, or at each join."""

    undocked_repulsion: bool = True
    """Use Eq. (2) in `algorithm-1`, for which robots hear of all others; without it they hear of
    those that they touch alone, once."""

    back_propagation: BackPropagation | None = None
    """Rounds of `algorithm-1` in which all robots move again; off if null."""

    channel: Literal["touch", "radio"] = "touch"
    """touch: robots in contact pass on what they hear, robot by robot. radio: all robots hear what
    one of them sends."""

    loss: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of transmissions that are lost [1]."""

    delay: Annotated[int, Field(ge=0, le=1000)] = 0
    """Rounds that a transmission takes beyond the next one [1]."""

    retries: Annotated[int, Field(ge=0, le=100)] = 4
    """Times at most that a transmission without an answer is repeated [1]."""

    bits: Annotated[int, Field(ge=8, le=32)] | None = 16
    """Bits of each number that is sent, in a range that its message states; all 64 if null."""

    hops: Annotated[int, Field(ge=1)] = 2
    """Steps of "shares a measurement" within which robots are asked [1]."""

    robots: Annotated[int, Field(ge=2)] = 100
    """Robots at most that are asked, and that a robot holds measurements of [1]."""

    solver: Literal["joiner", "keeper"] = "keeper"
    """Who solves: the robot that joined, or the nearest one that solved for the first robot that it
    touches, which holds the measurements of those nearby."""

    reach: Annotated[int, Field(ge=0, le=254)] = 12
    """Contacts at most to such a robot [1]; without one, the robot touched solves. With 12 the
    anchor solves for all of 100 robots; with 3 several robots do."""

    growth: Annotated[float, Field(gt=0.0)] = 0.1
    """Growth after which a robot that solves anneals all robots that it holds [1]."""

    chains: Annotated[int, Field(ge=0, le=1000)] = 8
    """Annealings of the robots nearby by the robot that solves; 0 for none."""

    steps: Annotated[int, Field(ge=1, le=10_000_000)] = 400
    """Steps of each annealing."""

    start_sigma: Annotated[float, Field(gt=0.0)] = 0.4
    """Square root of the temperature at which annealings begin [R]."""

    def __post_init__(self) -> None:
        """Refuse settings of another scheme."""
        usual = {field.name: field.default for field in fields(self)}
        for scheme, names in _OF_SCHEME.items():
            for name in names:
                if scheme != self.scheme and getattr(self, name) != usual[name]:
                    raise ValueError(
                        f"{name} is of scheme {scheme}; remove it, or set scheme to {scheme}"
                    )

    @property
    def published(self) -> VirtualForceParams:
        """Settings of Algorithm 1, for the scheme `algorithm-1`."""
        return VirtualForceParams(
            back_propagation=self.back_propagation, undocked_repulsion=self.undocked_repulsion
        )

    @property
    def cues(self) -> tuple[str, ...]:
        """What of the log is used; Algorithm 1 knows fewer cues."""
        return self.published.cues if self.scheme == "algorithm-1" else super().cues


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HopByHopParams(CueParams):
    """Order in which robots solve for their own positions, each once.

    Weights follow from the noise that the log states. Non-overlap decides between mirror images.
    """

    method: Literal["hop-by-hop"] = "hop-by-hop"
    """Name of the method."""

    touches: Literal[False] = False
    """Touches do not count: only `joint` finds their docks."""

    order: Literal["hops", "join"] = "hops"
    """hops: a robot follows once its measurements of the world and of located robots, whether these
    joined earlier or later, suffice. join: robots follow in join order and use those before them.
    """


LocalizationParams = Annotated[
    # | the settings of each further method
    VirtualForceParams
    | LeastSquaresParams
    | JointParams
    | HopByHopParams
    | OnlineParams
    | DistributedParams,
    Field(discriminator="method"),
]
"""Settings of any method."""
