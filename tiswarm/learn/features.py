"""The features of what a climber observes, and their bounds.

All of it a robot may know: the goal, its own walk, what its docks touch or would touch at the end
of a flip, and the loads that the robots which it touches have sensed.
"""

from typing import NamedTuple


class Feature(NamedTuple):
    """A number of an observation; it is cut off at its bounds."""

    name: str
    """Name."""

    unit: str
    """Unit."""

    low: float
    """Least value."""

    high: float
    """Greatest value."""

    meaning: str
    """What it is."""


FLIP_FEATURES = (
    Feature("possible", "1", 0, 1, "whether there is such a flip; all others are 0 if not"),
    Feature("distance", "R", 0, 200, "distance to the goal where it ends"),
    Feature("gain", "R", -20, 20, "by how much it comes nearer to the goal"),
    Feature("dx", "R", -10, 10, "how far its center goes along x"),
    Feature("dy", "R", -10, 10, "how far its center goes along y"),
    Feature("dz", "R", -10, 10, "how far its center goes up"),
    Feature("angle", "rad", -7, 7, "angle of the flip"),
    Feature("visited", "1", 0, 1, "whether the walk has been where it ends"),
    Feature("called", "1", 0, 1, "whether a dock that passes a call on is touched at its end"),
    Feature("touches", "1", 0, 12, "docks of robots that are touched at its end"),
    Feature("ground", "1", 0, 12, "docks of the climber on the ground at its end"),
    Feature("load", "weight of a dock", 0, 100, "greatest load sensed by robots touched there"),
)
"""Features of each flip."""

ROBOT_FEATURES = (
    Feature("climbs", "1", 0, 1, "whether there is a climber; all others are 0 if not"),
    Feature("distance", "R", 0, 200, "distance to the goal"),
    Feature("to_x", "R", -200, 200, "goal from its center, along x"),
    Feature("to_y", "R", -200, 200, "goal from its center, along y"),
    Feature("to_z", "R", -200, 200, "goal from its center, up"),
    Feature("best", "R", 0, 200, "least distance to the goal in its walk"),
    Feature("flips", "1", 0, 1000, "flips that it has tried"),
    Feature("since_best", "1", 0, 1000, "flips tried since it was nearest to the goal"),
    Feature("called", "1", 0, 1, "whether it touches a dock that passes a call on"),
    Feature("touches", "1", 0, 12, "docks of robots that it touches"),
    Feature("ground", "1", 0, 12, "docks on the ground"),
    Feature("load", "weight of a dock", 0, 100, "greatest load sensed by robots that it touches"),
)
"""Features of the climber."""

BELIEVED_FLIP_FEATURES = (
    *FLIP_FEATURES,
    Feature("sd", "R", 0, 200, "standard deviation of the place where it ends"),
)
"""Features of each flip where robots do not know the truth."""

BELIEVED_ROBOT_FEATURES = (
    *ROBOT_FEATURES,
    Feature("sd", "R", 0, 200, "standard deviation of its place"),
)
"""Features of the climber where robots do not know the truth."""


def features_of(*, by_belief: bool) -> tuple[tuple[Feature, ...], tuple[Feature, ...]]:
    """Return the features of each flip and of the climber, by whether it goes by beliefs."""
    if by_belief:
        return BELIEVED_FLIP_FEATURES, BELIEVED_ROBOT_FEATURES
    return FLIP_FEATURES, ROBOT_FEATURES
