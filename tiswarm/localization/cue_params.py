"""Settings that methods share: which cues of a log count, and how far."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.params import STRICT
from tiswarm.measurements.cues import cue_names

CUES = (
    "contacts",
    "non_overlap",
    "height",
    "ground",
    "walk_contacts",
    "odometry",
    "plane",
    "fixes",
    "ranges",
    "directions",
    "touches",
    "displacements",
)
"""Cues that settings have a switch for."""


def all_cues() -> tuple[str, ...]:
    """List those, and the ones that every method uses."""
    return tuple(dict.fromkeys((*CUES, *cue_names())))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CueParams:
    """Cues of a method that can do without any of them; each counts as far as the log has it.

    Fields that are inherited carry their text as a description, for the JSON Schema does not
    find the docstrings of a base class.
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
        bool, Field(description="Contacts of earlier stances count too, carried on by the flips.")
    ] = True

    odometry: Annotated[
        bool,
        Field(description="Robots that know where they started went as far as their flips say."),
    ] = True

    plane: Annotated[
        bool, Field(description="Planar robots are in the vertical plane of the anchor.")
    ] = True

    fixes: Annotated[
        bool, Field(description="Coordinates that a beacon or camera measured count.")
    ] = True

    ranges: Annotated[bool, Field(description="Measured distances of centers count.")] = True

    directions: Annotated[bool, Field(description="Measured directions of contacts count.")] = True

    touches: Annotated[bool, Field(description="Contacts whose docks are unknown count.")] = True

    displacements: Annotated[
        bool, Field(description="Measured vectors between the centers of two robots count.")
    ] = True

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
