"""Measures: numbers that compare estimates and structures, each defined once.

A measure is a score in `case.json`, a column of `summary.csv` and, averaged over structures, of
`table.csv`. To add one, add it here, in the order of `table.csv`, and compute it in
`tiswarm/evaluation/tables.py`. Tables, page and figures follow; `docs/measures.csv` has its row.
Plug-ins register a function, whose numbers stand in the tables alone:

    @tiswarm.measure("worst_R", unit="R", meaning="largest position error of a robot")
    def worst(truth, estimate):
        return np.linalg.norm(estimate.position - truth.position, axis=1).max()

Such a function asks for parts of a case, those of PARTS, by the names of its arguments.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import partial
from inspect import Parameter, signature
from typing import Any, Literal, TypeVar

from tiswarm.base.errors import InputError
from tiswarm.base.registry import register, registered, require_function

FEWEST = 5
"""Structures below which there is a range, but no confidence interval and no test, and no error is
called the smallest: without an effect, five differences have one sign in 6 % of studies."""


@dataclass(frozen=True)
class Measure:
    """A number of a case."""

    column: str
    """Name of its score and of its column."""

    unit: str
    """Its unit; "1" for pure numbers."""

    source: str
    """What it is computed from."""

    meaning: str
    """What it is, in words."""

    _: KW_ONLY

    label: str = ""
    """Its name along axes and in sentences, without unit."""

    better: Literal["", "smaller", "larger"] = ""
    """Which values are better, if either."""

    averaged: bool = True
    """Whether `table.csv` has its statistics."""

    paired: bool = False
    """Whether `paired.csv` has its differences between conditions."""

    published: str = ""
    """Column of `table.csv` with the paper's number, if the paper has one."""

    is_share: bool = False
    """Whether it is a share from 0 to 1, or 0 or 1, whose mean over structures is a share."""

    is_yes_or_no: bool = False
    """Whether it is 0 or 1 for each structure, so that its mean is the share of structures with 1.

    Other shares are of the robots, contacts or flips of a structure.
    """

    @property
    def needs_estimate(self) -> bool:
        """Whether only cases whose robots were localized have it."""
        return self.source not in {_STRUCTURE, _WALKS, _SWARM}

    @property
    def is_of_engine(self) -> bool:
        """Whether runs of the engine have it, and nothing else."""
        return self.source == _SWARM

    @property
    def axis(self) -> str:
        """Label with the unit, if it has one; shares name theirs."""
        if self.is_share:
            return f"{self.label} [share]"
        return self.label if self.unit == "1" else f"{self.label} [{self.unit}]"

    @property
    def mean(self) -> str:
        """Column of its mean."""
        return self.statistic("mean")

    @property
    def ci95(self) -> str:
        """Column of the half width of the confidence interval; shares have `bounds` instead."""
        return self.statistic("ci95")

    @property
    def bounds(self) -> tuple[str, str]:
        """Columns of the ends of the confidence interval of a share."""
        return self.statistic("ci95_low"), self.statistic("ci95_high")

    @property
    def least(self) -> str:
        """Column of its least value."""
        return self.statistic("least")

    @property
    def most(self) -> str:
        """Column of its greatest value."""
        return self.statistic("most")

    def statistic(self, name: str) -> str:
        """Return the column of a statistic over structures.

        Also `std`, the standard deviation, and `count`, of what is 0 or 1, of structures with it.
        """
        return f"{self.column}_{name}"


# Measures whose smaller, or larger, values are better.
_smaller = partial(Measure, better="smaller")
_larger = partial(Measure, better="larger")

_STRUCTURE = "structure"
_BOTH = "structure, estimate"
_ESTIMATE = "estimate"
_LOG = "log, cues"
_WALKS = "walks"
_TRAFFIC = "messages"
_SWARM = "swarm"


JOINED = Measure("joined", "1", _STRUCTURE, "robots that joined")
LEFT, FELL, DIED = (
    Measure(name, "1", _STRUCTURE, f"robots that {event}; empty where none may")
    for name, event in (
        ("left", "left"),
        ("fell", "fell as others left or contacts broke"),
        ("died", "died"),
    )
)
BROKEN = Measure(
    "broken",
    "1",
    _STRUCTURE,
    "contacts that broke; empty where docks hold any load",
    label="Broken contacts",
)
STANDING = Measure(
    "standing",
    "1",
    _STRUCTURE,
    "robots that stand in the end; empty where docks hold any load",
    label="Robots that stand",
)
MARGIN = _larger(
    "least_margin",
    "1",
    _STRUCTURE,
    "least strength of a contact in parts of its load; empty where docks hold any load, or no "
    "contact has load",
    label="Least margin",
)
TIPPED, SLID = (
    Measure(
        name,
        "1",
        _STRUCTURE,
        f"whether the structure {name} on docks that rest; empty where the ground holds them",
        label=f"Structures that {name}",
        is_share=True,
        is_yes_or_no=True,
    )
    for name in ("tipped", "slid")
)
DISCONNECTED = _smaller(
    "disconnected", "1", _ESTIMATE, "robots that no measurement ties to an anchor"
)
CONTACTS = Measure(
    "contacts_per_robot",
    "1",
    _STRUCTURE,
    "contacts of a robot with earlier ones, in the mean",
    label="Contacts per robot",
)
RMS_RADIUS = Measure(
    "rms_radius_R", "R", _STRUCTURE, "root mean square distance of robots from their centroid"
)
HEIGHT = Measure(
    "height_R", "R", _STRUCTURE, "height of the highest robot above the ground", label="Height"
)
REACH = Measure("reach_R", "R", _STRUCTURE, "greatest x of a robot", label="Reach")
DEPTH = Measure(
    "depth_R", "R", _STRUCTURE, "depth of the lowest robot below the ground", label="Depth"
)
BEYOND_EDGE = Measure(
    "beyond_edge",
    "1",
    _STRUCTURE,
    "share of the robots beyond the edge, or over the gap; empty on flat ground",
    is_share=True,
)
ABOVE_CROWD = Measure(
    "above_crowd",
    "1",
    _STRUCTURE,
    "share of the robots more than 20 R above flat ground; empty elsewhere",
    is_share=True,
)
CROSSED = Measure(
    "crossed",
    "1",
    _STRUCTURE,
    "whether a bridge joins both sides of its gap",
    label="Bridges closed",
    is_share=True,
    is_yes_or_no=True,
)
FLIPS_AS_PLANNED = _larger(
    "flips_as_planned",
    "1",
    _WALKS,
    "share of all flips tried that ended at the robot, or on the ground, as planned; the way back "
    "does not count; empty where robots know the truth",
    label="Flips as planned",
    is_share=True,
)
FAILED_FLIPS = _smaller(
    "failed_flips",
    "1",
    _WALKS,
    "flips that met nothing, or where the robot had been, for each flip taken; empty where robots "
    "know the truth",
)
TRIES = _smaller(
    "tries_per_robot",
    "1",
    _WALKS,
    "flips of a robot in the mean, the way back to its best stance and failed ones included",
)
BELIEF_BUILDING, BELIEF_NEWEST, BELIEF_FINAL, BELIEF_PER_CONTACT = (
    Measure(
        f"belief_{name}_R",
        "R",
        _WALKS,
        f"{error}; empty where robots know the truth",
        better="smaller",
    )
    for name, error in (
        ("building", "RMSE of the places that robots believed after each join, over all joins"),
        ("newest", "RMSE of the place of the newest robot, as believed once it had joined"),
        ("final", "RMSE of the places that robots believed after the last join"),
        ("per_contact", "the same, of the vector between two robots in contact"),
    )
)
BELIEF_SENT = _smaller(
    "belief_sent_B",
    "B",
    _WALKS,
    "sent by a robot in the mean for the places that robots build by; empty where they send none",
    label="Sent by a robot",
)
BELIEF_WORST_SENT = _smaller("belief_worst_sent_B", "B", _WALKS, "most that a robot sent for these")
RULE_SENT = _smaller(
    "rule_sent_B",
    "B",
    _STRUCTURE,
    "sent by a robot in the mean by the rule of growth; empty where that has no messages",
    label="Sent by the rule",
)
RULE_WORST_SENT = _smaller("worst_rule_sent_B", "B", _STRUCTURE, "most that a robot sent by it")
PEAK_STRESS = Measure(
    "peak_stress", "dock weights/R^2", _STRUCTURE, "largest stress in any contact"
)
FLOPPY_MODES = _smaller(
    "floppy_modes",
    "1",
    _LOG,
    "motions that change no measurement that the method uses; empty where they were not counted",
    label="Floppy modes",
)
EXPECTED_RMSE = Measure(
    "expected_rmse_R",
    "R",
    _ESTIMATE,
    "RMSE that the estimate expects, the root mean square of `sd_R`, without anchors and guesses; "
    "empty if the method states no `sd_R`",
    label="Expected RMSE",
)
COVERAGE_50 = Measure(
    "coverage_50",
    "1",
    _BOTH,
    "share of robots, without anchors, in their 50 % interval",
    is_share=True,
)
COVERAGE_90 = Measure(
    "coverage_90",
    "1",
    _BOTH,
    "share of robots, without anchors, in their 90 % interval",
    is_share=True,
)
SURE = _larger(
    "sure_1R",
    "1",
    _ESTIMATE,
    "share of robots, without anchors, that are within 1 R of their estimated positions with a "
    "probability of 95 % or more, `within_1R`; empty if the method states no `sd_R`",
    is_share=True,
)
SURE_OFF = Measure(
    "sure_off_1R",
    "1",
    _BOTH,
    "share of these that are off by 1 R or more; empty without any",
    is_share=True,
)
PRECISION = _larger(
    "outlier_precision",
    "1",
    _BOTH,
    "wrong contacts among those reported as outliers",
    is_share=True,
)
RECALL = _larger(
    "outlier_recall", "1", _BOTH, "reported outliers among wrong contacts", is_share=True
)
CONVERGED = _larger(
    "converged",
    "1",
    _ESTIMATE,
    "whether the method converged",
    is_share=True,
    is_yes_or_no=True,
)
CONSISTENT = _larger(
    "consistent",
    "1",
    _ESTIMATE,
    "whether noise as stated explains the measurements; empty where that was not tested",
    is_share=True,
    is_yes_or_no=True,
)
TESTABLE = Measure(
    "testable",
    "1",
    _ESTIMATE,
    "whether the log could be found not consistent: it was, or it has spare measurements",
    is_share=True,
    is_yes_or_no=True,
)
SPARE = Measure(
    "spare_measurements",
    "1",
    _ESTIMATE,
    "measurements beyond the unknowns that they determine; empty where they were not counted",
)
OPEN = Measure(
    "open_robots",
    "1",
    _ESTIMATE,
    "robots tied to the anchor whose positions the measurements do not determine: free motions "
    "move them; empty where these were not found out",
)
MISFIT = Measure(
    "misfit_sd",
    "1",
    _ESTIMATE,
    "excess of the least chi-square over its expectation, in standard deviations of a chi-square",
)
SD_FACTOR = Measure(
    "sd_factor", "1", _ESTIMATE, "Birge ratio that multiplied `sd_R`; 1 if consistent"
)
MIRRORED = Measure(
    "mirrored",
    "1",
    _ESTIMATE,
    "robots that solutions put apart; empty if the method looks for one solution only",
)
SUSPECTS = Measure(
    "suspects",
    "1",
    _ESTIMATE,
    "robots that the estimate names, since their measurements all disagree: outliers, whose "
    "orientations do not count; 0 with methods that name none",
)
STEPS = Measure(
    "steps_per_robot",
    "1",
    _ESTIMATE,
    "steps of a robot in the mean, those in rounds of back-propagation included",
    label="Steps per robot",
)
LOCATED = _larger(
    "located",
    "1",
    _ESTIMATE,
    "share of robots located, without anchors: measurements tie them to the anchor, and determine "
    "their positions if the method places robots one by one",
    label="Located robots",
    is_share=True,
)
RMSE_LOCATED = _smaller(
    "rmse_located_R",
    "R",
    _BOTH,
    "RMSE of the robots located, without anchors; empty if there are none",
    label="RMSE of located robots",
)
RMSE_AT_JOIN = _smaller(
    "rmse_at_join_R", "R", _BOTH, "RMSE of robots as they joined, if the method places them then"
)
WITHIN_DOCK = _larger(
    "within_dock",
    "1",
    _BOTH,
    "share of robots, without anchors, whose error is at most 2 R",
    is_share=True,
)
CONTACTS_WITHIN_DOCK = _larger(
    "contacts_within_dock",
    "1",
    _BOTH,
    "share of pairs in contact whose vector errs by at most 2 R",
    is_share=True,
)
DOUBTFUL = Measure(
    "doubtful",
    "1",
    _ESTIMATE,
    "robots that do not trust their own positions, if robots localize themselves",
)
SENT = _smaller(
    "sent_B",
    "B",
    _TRAFFIC,
    "sent by a robot in the mean, what it passes on for others included",
    label="Sent by a robot",
)
WORST_SENT = _smaller("worst_sent_B", "B", _TRAFFIC, "most that a robot sent")
HEARD = _smaller("heard_B", "B", _TRAFFIC, "heard by a robot in the mean")
WORST_HEARD = _smaller("worst_heard_B", "B", _TRAFFIC, "most that a robot heard")
MEMORY = _smaller("memory_B", "B", _TRAFFIC, "stored by a robot in the mean")
WORST_MEMORY = _smaller("worst_memory_B", "B", _TRAFFIC, "most that a robot stored")
MESSAGES = _smaller("messages", "1", _TRAFFIC, "messages that a robot sent, in the mean")
ROUNDS = _smaller("rounds", "1", _TRAFFIC, "rounds with messages, which all robots share")
OPERATIONS = _smaller("operations", "1", _TRAFFIC, "operations of a robot, in the mean")
WORST_OPERATIONS = _smaller("worst_operations", "1", _TRAFFIC, "most operations of a robot")
SOLVED_SHARE = _smaller(
    "solved_share", "1", _TRAFFIC, "largest share of joins that one robot solves", is_share=True
)
FIRST_ON_ANCHOR, SECOND_ON_ANCHOR, THIRD_ON_ANCHOR = (
    Measure(
        f"{place}_on_anchor",
        "1",
        _STRUCTURE,
        f"join index of the {place} robot that touches an anchor; the first anchor has index 0; "
        "empty if fewer do, so the mean is over structures in which so many do",
    )
    for place in ("first", "second", "third")
)
RMSE = _smaller(
    "rmse_R",
    "R",
    _BOTH,
    "root mean square position error of all robots",
    label="RMSE",
    paired=True,
    published="paper_rmse_radii",
)
RMSE_RHO = _smaller(
    "rmse_rho", "rho", _BOTH, "RMSE in distances from a robot's center to a dock", paired=True
)
RMSE_YAW_ALIGNED = _smaller(
    "rmse_yaw_aligned_R", "R", _BOTH, "RMSE after alignment by yaw and translation", paired=True
)
RMSE_RIGID_ALIGNED = _smaller(
    "rmse_rigid_aligned_R",
    "R",
    _BOTH,
    "RMSE after alignment by rotation and translation",
    paired=True,
)
RMSE_PER_CONTACT = _smaller(
    "rmse_per_contact_R",
    "R",
    _BOTH,
    "RMSE of the vector between two robots in contact, one hop apart",
    paired=True,
)
DISPARITY = _smaller(
    "procrustes_disparity",
    "1",
    _BOTH,
    "squared error after rigid alignment, relative to the squared extent of the structure",
    label="Procrustes disparity",
    paired=True,
    published="paper_procrustes_disparity",
)
SSE = _smaller("sse_R2", "R^2", _BOTH, "sum of squared position errors", averaged=False)
CHAINS = Measure(
    "chains", "1", _ESTIMATE, "chains, or starts, that enter the estimate", averaged=False
)
RESTARTED = Measure(
    "restarted_chains", "1", _ESTIMATE, "annealings that were repeated", averaged=False
)
WRONG_CONTACTS = Measure(
    "wrong_contacts", "1", _BOTH, "contacts of the log that the structure lacks", averaged=False
)
OUTLIERS = Measure("outliers", "1", _ESTIMATE, "contacts reported as outliers", averaged=False)
SENSED_MAX = Measure(
    "sensed_max", "dock weights", _STRUCTURE, "largest load that any robot senses", averaged=False
)
RECRUITED = Measure(
    "recruited", "1", _STRUCTURE, "robots that others called to their aid", averaged=False
)
SPAWNS = Measure(
    "spawns", "1", _STRUCTURE, "robots spawned, those that never joined included", averaged=False
)
SETTLED = _larger(
    "settled",
    "1",
    _SWARM,
    "whether the longest last step of a robot is shorter than `settled_below`",
    label="Settled",
    is_share=True,
    is_yes_or_no=True,
)
LAST_MOVE = _smaller(
    "last_move_R", "R", _SWARM, "longest last step of a robot", label="Longest last step"
)
OVERLAP = _smaller(
    "greatest_overlap_R",
    "R",
    _SWARM,
    "most by which two docks that are not connected are nearer than D in the end",
    label="Greatest overlap",
)
CONTACT_GAP = _smaller(
    "contact_gap_R",
    "R",
    _SWARM,
    "root mean square by which connected docks miss D in the end; empty without any",
    label="Gap of contacts",
)
MOVED = Measure(
    "moved_R",
    "R",
    _SWARM,
    "root mean square distance of robots from where they started",
    label="Way of a robot",
)
LIST_BUILDS = Measure(
    "list_builds", "1", _SWARM, "how often neighbor lists were made", label="Neighbor lists"
)

MEASURES = {value.column: value for value in [*globals().values()] if isinstance(value, Measure)}
"""All measures of the package by column, in the order above."""

MAIN = (RMSE, DISPARITY)
"""The two that state accuracy: the paper's, in headlines, figures and studies of size."""

OF_LOCATED = (RMSE, LOCATED, RMSE_LOCATED)
"""What states accuracy where not all robots are located: RMSE of all, share and RMSE of these."""

BUILT_FOR = {"tower": HEIGHT, "cantilever": REACH, "chain": DEPTH, "bridge": CROSSED}
"""By kind of structure, the measure of what it is built for."""

_ON_ANCHOR = {
    FIRST_ON_ANCHOR: "first robot",
    SECOND_ON_ANCHOR: "second robot",
    THIRD_ON_ANCHOR: "third robot",
}
_LIMITS = {
    CONTACTS: "contacts per robot",
    FLOPPY_MODES: "floppy modes",
    RMS_RADIUS: "rms radius [R]",
}
_OF_LOCATED = {LOCATED: "robots located", RMSE_LOCATED: "RMSE of robots located [R]"}

PAGE: Mapping[str, dict[Measure, str]] = {
    "accuracy": {RMSE: "RMSE [R]", DISPARITY: "disparity"},
    "aligned": {
        RMSE: "not aligned",
        RMSE_YAW_ALIGNED: "yaw and translation aligned",
        RMSE_RIGID_ALIGNED: "rigidly aligned",
    },
    "attachment": {
        WITHIN_DOCK: "share of robots within 2 R",
        RMSE_PER_CONTACT: "neighbors [R]",
        CONTACTS_WITHIN_DOCK: "share of neighbors within 2 R",
    },
    "limits": _LIMITS,
    "calibration": {
        EXPECTED_RMSE: "expected RMSE [R]",
        COVERAGE_50: "robots in their 50 % interval",
        COVERAGE_90: "robots in their 90 % interval",
        SURE: "robots within 1 R (95 %)",
        SURE_OFF: "of these off by more",
        PRECISION: "precision of outliers",
        RECALL: "recall of outliers",
        CONVERGED: "converged estimates",
        CONSISTENT: "consistent estimates",
        SD_FACTOR: "factor of sd",
        MIRRORED: "mirrored robots",
        **_OF_LOCATED,
    },
    "anchor": _ON_ANCHOR,
    "suites": {
        RMSE: "RMSE of all [R]",
        LOCATED: "positions determined",
        RMSE_LOCATED: "RMSE of these robots [R]",
        DISPARITY: "disparity",
        FLOPPY_MODES: "floppy modes",
    },
    "structures": {
        STANDING: "standing",
        FELL: "fell",
        LEFT: "left",
        DIED: "died",
        BROKEN: "broken contacts",
        MARGIN: "least margin",
        TRIES: "flips per robot",
        PEAK_STRESS: "peak stress",
    },
    "swarms": {
        SETTLED: "settled",
        LAST_MOVE: "last step [R]",
        OVERLAP: "greatest overlap [R]",
        CONTACT_GAP: "gap of contacts [R]",
        MOVED: "moved [R]",
        LIST_BUILDS: "neighbor lists",
    },
    "cases": {
        JOINED: "joined",
        **{measure: measure.column for measure in (LEFT, FELL, DIED, BROKEN, STANDING)},
        MARGIN: "least margin",
        DISCONNECTED: "disconnected",
        RMSE: "RMSE [R]",
        RMSE_YAW_ALIGNED: "yaw aligned [R]",
        RMSE_RIGID_ALIGNED: "rigidly aligned [R]",
        DISPARITY: "disparity",
        **_LIMITS,
        HEIGHT: "height [R]",
        PEAK_STRESS: "peak stress",
    },
}
"""By table of a run's page, the headings of its measures in order, without those of plug-ins."""

_COLUMN = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
_Value = TypeVar("_Value", bound=Callable[..., Any])


PARTS = ("truth", "estimate", "log", "history", "settings")
"""What a function of a measure may ask for, by the names of its arguments."""

_NAMELESS = PARTS[:2]
"""What a function receives whose two arguments have no name of a part."""


@dataclass(frozen=True, kw_only=True)
class PluginMeasure(Measure):
    """A measure that a plug-in registered."""

    value: Callable[..., Any]
    """Function of parts of a case, which returns the number."""

    asks: tuple[str, ...]
    """Parts that it asks for, in the order of its arguments."""

    by_name: bool = True
    """Whether it receives them by name; else in their order."""

    optional: tuple[str, ...] = ()
    """Parts that it can do without: those of arguments with defaults."""

    @property
    def needs_estimate(self) -> bool:
        """Whether only cases whose robots were localized have it."""
        return "estimate" in self.asks and "estimate" not in self.optional

    def call(self, parts: Mapping[str, object]) -> Any:  # noqa: ANN401 - as the plug-in returns it
        """Call the function with the parts that it asks for."""
        if self.by_name:
            return self.value(**parts)
        return self.value(*parts.values())


def measure(
    name: str, *, meaning: str, unit: str = "1", better: Literal["", "smaller", "larger"] = ""
) -> Callable[[_Value], _Value]:
    """Register a function as a measure, a column of the tables and of the page of each run.

    The names of the function's arguments say what of a case it receives, all in join order:

    - truth: `tiswarm.records.positions.Truth` [R].
    - estimate: `tiswarm.records.estimate.Estimate` as a run stores it [R]. A case without one has
      no value, unless the argument has a default.
    - log: `tiswarm.records.sensing_log.SensingLog`.
    - history: `tiswarm.world.history.History` of the structure, as `tiswarm.grow` returns it.
    - settings: `tiswarm.scenario.model.Scenario` of the case, without its seed.

    It returns a number, NaN where it is unknown.

    Args:
        name: Name of the column, such as "worst_R".
        meaning: What the number is, in words.
        unit: Its unit; "1" for pure numbers.
        better: Which values are better, if either. Where smaller ones are, `paired.csv` has the
            differences between conditions.

    Raises:
        InputError: the name is taken or invalid, or the function asks for something else.
    """
    if not _COLUMN.fullmatch(name):
        raise InputError(f"{name!r} names no column; use letters, digits and '_', like worst_R")
    if name in MEASURES:
        raise InputError(f"measure {name} is taken by tiswarm itself; choose another name")

    def add(value: _Value) -> _Value:
        require_function("measure", name, value)  # before its arguments are read
        asks, optional, by_name = _asked(name, value)
        made = PluginMeasure(
            name,
            unit,
            ", ".join(asks),
            meaning,
            better=better,
            paired=better == "smaller",
            value=value,
            asks=asks,
            optional=optional,
            by_name=by_name,
        )
        register("measure", name, made, value)
        return value

    return add


def _asked(
    name: str, function: Callable[..., Any]
) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
    """Return the parts that a function asks for, those with defaults, and whether by their names.

    A function with two arguments of other names receives truth and estimate.

    Raises:
        InputError: an argument has no name of a part.
    """
    try:
        arguments = [*signature(function).parameters.values()]
    except (TypeError, ValueError):  # such as a ufunc of NumPy
        return _NAMELESS, (), False
    several = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    arguments = [argument for argument in arguments if argument.kind not in several]
    part_arguments = [argument for argument in arguments if argument.name in PARTS]
    needed = [argument for argument in arguments if argument.default is Parameter.empty]
    if not part_arguments and len(needed) == len(_NAMELESS):
        return _NAMELESS, (), False
    nameless = [argument.name for argument in needed if argument.name not in PARTS]
    if nameless or not part_arguments:
        named = f"argument {nameless[0]}" if nameless else "no argument"
        problem = f"measure {name}: {named} is none of {', '.join(PARTS)}; name what it asks for"
        raise InputError(problem)
    optional = tuple(argument.name for argument in part_arguments if argument not in needed)
    by_name = all(argument.kind != Parameter.POSITIONAL_ONLY for argument in part_arguments)
    return tuple(argument.name for argument in part_arguments), optional, by_name


def plugin_measures() -> dict[str, PluginMeasure]:
    """Return the measures of plug-ins by column."""
    return {name: entry.value for name, entry in registered("measure").items()}


def need(part: str) -> bool:
    """Whether a measure of a plug-in asks for a part of cases."""
    return any(part in measure.asks for measure in plugin_measures().values())


def all_measures() -> list[Measure]:
    """List the measures of the package, in their order, and those of plug-ins."""
    return [*MEASURES.values(), *plugin_measures().values()]


def paired_measures() -> list[Measure]:
    """List the measures whose differences between conditions `paired.csv` has."""
    return [measure for measure in all_measures() if measure.paired]


def plugin_headings() -> dict[Measure, str]:
    """Return the headings of the measures of plug-ins on a run's page."""
    return {
        measure: measure.column if measure.unit == "1" else f"{measure.column} [{measure.unit}]"
        for measure in plugin_measures().values()
    }
