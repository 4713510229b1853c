"""Localization by robots that know their own measurements and what others sent them.

Here are the settings of `distributed`, each with its unit and its reason. Lengths in R.
"""

from dataclasses import fields
from typing import Annotated, ClassVar, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.params import STRICT, UNLESS_SET
from tiswarm.base.sections import NameOf, SendsPlugins
from tiswarm.localization.settings import (
    BackPropagation,
    ChiSquareParams,
    CuesOfNamedDocks,
    VirtualForceParams,
)

_JOIN_S = 0.01
"""Processor time of a join by messages, without annealing [s]."""

_STEP_S = 8e-6, 1e-7
"""Processor time of a step of one chain of it: at all, and for each robot [s]."""

_SENDING_S = 1.5e-3
"""Processor time of the messages of a robot in Algorithm 1 [s]."""

_OF_SCHEME = {
    "joiner": (
        "hops",
        "asked",
        "robots",
        "solver",
        "reach",
        "tenure",
        "reviews",
        "growth",
        "chains",
        "steps",
        "start_sigma",
        "delay",
        "routes",
        "timer",
        "join_rounds",
    ),
    "algorithm-1": ("poses", "back_propagation", "undocked_repulsion"),
}
"""Settings that have a meaning in one scheme only."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DistributedParams(ChiSquareParams, SendsPlugins):
    """What robots send each other to find out where they are, and by which channel.

    A robot computes from its own measurements and from what it was sent. By default several robots
    solve, each for those that join within `reach` of it. With the solver `base` the anchor solves
    for all.
    """

    module: ClassVar = "tiswarm.localization.distributed.method"
    calls: ClassVar = VirtualForceParams

    method: Literal["distributed"] = "distributed"
    """Name of the method."""

    cues: CuesOfNamedDocks = CuesOfNamedDocks()
    """Cues in use, each of them on or off; all contacts name their docks."""

    solve_yaw: Literal[False] = False
    """No bias of yaw is solved for."""

    scheme: Literal["joiner", "algorithm-1"] = "joiner"
    """joiner: where a robot joins, one robot, the `solver`, asks those nearby for what they
    measured, solves for their positions and sends them the answer. algorithm-1: the paper's, by the
    defaults of `virtual-force`, without rounding. By radio a robot goes without poses that it does
    not hear; by touch all are repeated until they are heard."""

    poses: Literal["once", "every-join", "asked"] = "every-join"
    """When robots send their poses in `algorithm-1`: once they are placed, at each join, or if they
    are in reach of the robot that joins, to it."""

    undocked_repulsion: bool = True
    """Use Eq. (2) in `algorithm-1`, for which robots hear of all others; without it they hear of
    those that they touch alone, once."""

    back_propagation: BackPropagation | None = None
    """Rounds of `algorithm-1` in which all robots move again; off if null."""

    channel: Annotated[str, NameOf("channel")] = "touch"
    """touch: robots in contact pass on what they hear, robot by robot. radio: robots in reach hear
    what one of them sends. Plug-ins add channels, in which robots are in reach as by radio."""

    radio_reach: Annotated[Literal["ranged"] | None, UNLESS_SET] = None
    """ranged: in reach of a radio are robots in contact, and those between which a range was
    measured, up to `sensing.range_reach`; nothing else is made of ranges. All are if null."""

    loss: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of transmissions that are lost [1]."""

    burst: Annotated[float | None, Field(ge=1.0, le=1e6), UNLESS_SET] = None
    """Mean number of rounds that the way from one robot to another stays bad once it is, so that
    losses come in bursts [1]; each is by itself if null."""

    slots: Annotated[int | None, Field(ge=1, le=1_000_000), UNLESS_SET] = None
    """Slots of a round by radio. Each transmission takes one by chance. A robot in reach of two in
    the same slot hears neither [1]. Nothing collides if null."""

    delay: Annotated[int, Field(ge=0, le=1000)] = 0
    """Rounds that a transmission takes beyond the next one [1]."""

    retries: Annotated[int, Field(ge=0, le=100)] = 5
    """Times at most that a transmission or a question without an answer is repeated, each after a
    pause twice as long as the one before [1]."""

    routes: Annotated[Literal["known", "learned"], UNLESS_SET] = "known"
    """known: robots know the shortest way along contacts to each other. learned: they know by whom
    messages of others came; what has no route goes to all, and each robot passes it on once."""

    timer: Annotated[int | None, Field(ge=1, le=1_000_000), UNLESS_SET] = None
    """Rounds for which a robot waits for an answer before it asks again, or goes on without [1];
    if null it does so exactly when no answer can come any more."""

    join_rounds: Annotated[int | None, Field(ge=1, le=1_000_000), UNLESS_SET] = None
    """Rounds from one join to the next, even with messages under way [1]; if null a robot joins
    when all messages of the last join have ended."""

    bits: Annotated[int, Field(ge=8, le=32)] | None = 16
    """Bits of each number that is sent, in a range that its message states; all 64 if null."""

    hops: Annotated[int, Field(ge=1)] = 2
    """Steps of "shares a measurement" within which robots are asked [1]."""

    asked: Annotated[int, Field(ge=1)] = 12
    """Robots at most that are asked at a join, the last that joined first [1]."""

    robots: Annotated[int, Field(ge=2)] = 100
    """Robots at most that a robot holds measurements of [1]."""

    solver: Literal["base", "keeper", "joiner"] = "keeper"
    """Who solves. base: the anchor, for all. keeper: the nearest robot that solved for the first
    one that the new robot touches, and holds what those nearby sensed. joiner: the new robot."""

    reach: Annotated[int, Field(ge=0, le=254)] = 3
    """Contacts at most to a keeper [1]; without one, the robot touched solves."""

    tenure: Annotated[int, Field(ge=1)] = 8
    """Joins at most that a robot solves for, unless it is the base [1]."""

    reviews: Annotated[int, Field(ge=0, le=100)] = 1
    """Times that all robots that solved do so again after the last join, one after the other, and
    let what hangs on others move as one [1]."""

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
        for scheme, of_scheme in _OF_SCHEME.items():
            for name in of_scheme:
                if scheme != self.scheme and getattr(self, name) != usual[name]:
                    raise ValueError(
                        f"{name} is of scheme {scheme}; remove it, or set scheme to {scheme}"
                    )
        shortest = 1.0 / (1.0 - self.loss)
        if self.burst is not None and self.burst < shortest:
            raise ValueError(
                f"burst {self.burst:g} is shorter than without bursts, {shortest:.3g} at loss "
                f"{self.loss:g}; raise it or leave it out"
            )
        wired = [name for name in ("radio_reach", "slots") if getattr(self, name) != usual[name]]
        if self.channel == "touch" and (wired or self.poses == "asked"):
            what = [*wired, "poses asked"][0]
            raise ValueError(f"{what} is of radio; remove it, or set channel to radio")
        if self.routes == "learned" and self.channel != "touch" and self.radio_reach is None:
            raise ValueError(
                "routes learned needs robots that pass messages on, and this radio reaches all; "
                "remove it, or set channel to touch"
            )
        if self.scheme == "algorithm-1" and self.channel == "touch" and self.burst is not None:
            raise ValueError("burst of algorithm-1 is of radio; remove it, or set channel to radio")
        if self.misses_poses and (self.poses == "once" or self.back_propagation):
            what = "back_propagation" if self.back_propagation else "poses once"
            raise ValueError(
                f"{what} needs all poses, and channel {self.channel} loses some; remove loss and "
                "slots, or choose poses every-join or asked without back_propagation"
            )
        if self.solver != "keeper" and self.reach != usual["reach"]:
            raise ValueError("reach is of solver keeper; remove it, or set solver to keeper")

    @property
    def ranges(self) -> bool:
        """Whether measured ranges are used, not only to know who is in reach."""
        return self.radio_reach is None

    @property
    def misses_poses(self) -> bool:
        """Whether a robot of `algorithm-1` may have to go without poses of others."""
        if self.scheme != "algorithm-1" or self.channel == "touch":
            return False
        return self.loss > 0.0 or self.slots is not None or self.channel != "radio"

    @property
    def joining(self) -> str:
        """Class whose robots localize themselves as they join; empty if they send afterwards."""
        if self.scheme == "joiner":
            return "PeerSwarm"
        sends_later = self.undocked_repulsion and self.poses == "once"
        return "" if sends_later or self.back_propagation else "PublishedSwarm"

    @property
    def published(self) -> VirtualForceParams:
        """Settings of Algorithm 1, for the scheme `algorithm-1`."""
        return VirtualForceParams(
            back_propagation=self.back_propagation, undocked_repulsion=self.undocked_repulsion
        )

    @property
    def used_cues(self) -> tuple[str, ...]:
        """What of the log is used; Algorithm 1 knows fewer cues."""
        return self.published.used_cues if self.scheme == "algorithm-1" else super().used_cues

    def seconds(self, robots: int) -> float:
        """Estimate the processor time of robots that localize themselves [s]."""
        if self.scheme == "algorithm-1":
            return _SENDING_S * robots + self.published.seconds(robots)
        of_step, of_robot = _STEP_S
        steps = self.chains * self.steps
        return robots * (_JOIN_S + steps * (of_step + of_robot * robots))
