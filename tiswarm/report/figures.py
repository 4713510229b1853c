"""Draws the figures of a run, whose kinds have modules of their own, and captions all pictures."""

from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.base.errors import InputError
from tiswarm.base.parts import load
from tiswarm.base.progress import Progress
from tiswarm.records import outputs
from tiswarm.records.messages import did_you_mean
from tiswarm.report import figure_style
from tiswarm.report.figure_style import (
    COLUMN_WIDTH,
    NARROW,
    Painter,
    is_narrow,
    pdf,
    png,
    svg,
)
from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_FORMS = ("png", "pdf", "svg")

FIGURES = (
    "tiswarm.report.error_figures:error_painters",
    "tiswarm.report.table_figures:building_painters",
    "tiswarm.report.joining_figure:joining_painters",
    "tiswarm.report.traffic_figure:traffic_painters",
    "tiswarm.report.curve_figures:scaling_painters",
    "tiswarm.report.table_figures:grade_painters",
    "tiswarm.report.table_figures:table_painters",
    "tiswarm.report.suite_figure:suite_painters",
    "tiswarm.report.curve_figures:round_painters",
    "tiswarm.report.curve_figures:profile_painters",
)
"""Functions of a run that return, by file name, the functions that draw figures which it has."""


def draw_figures(run: RunData, progress: Progress, *, vector: bool = False) -> list[Path]:
    """Draw every figure of a run into `figures/`, as PNG, as SVG and, if wanted, as PDF too.

    A second SVG of a wide figure is drawn as wide as a column, for narrow screens.
    Cases that failed are left out, and a note on each figure states their number. A figure of an
    earlier call that the run no longer has is removed, but no other file; an existing PDF is
    redrawn.

    Returns:
        The files written; empty where no case is done.
    """
    from matplotlib import style

    written = []
    painters = painters_of(run) if run.series else {}
    if not painters:
        progress.info("no figures: no case is done")
    with style.context(["default", figure_style.STYLE]):
        for name, draw in painters.items():
            figure = draw(run)
            for suffix, encode in (("png", png), ("pdf", pdf), ("svg", svg)):
                path = run.subfolder("figures") / f"{name}.{suffix}"
                if suffix != "pdf" or vector or path.exists():
                    outputs.write_own(path, encode(figure))
                    progress.info(f"figures/{path.name}")
                    written.append(path)
            if not is_narrow(figure):
                path = run.subfolder("figures") / f"{name}{NARROW}.svg"
                outputs.write_own(path, svg(draw(run, COLUMN_WIDTH)))
                written.append(path)
    folder = run.folder / "figures"
    for path in {path for form in _FORMS for path in folder.glob(f"*.{form}")} - {*written}:
        if outputs.is_own(path):
            path.unlink(missing_ok=True)
    return written


def draw_figure(run: RunData, name: str) -> "Figure":
    """Draw one figure of a run, to be changed and saved by the caller.

    Raises:
        InputError: the run has no figure of that name; lists those that it has.
    """
    from matplotlib import style

    painters = painters_of(run) if run.series else {}
    if name not in painters:
        some = f"; choose one of {', '.join(painters)}" if painters else ""
        problem = f"there is no figure {name!r}{some}{did_you_mean(name, [*painters])}"
        raise InputError(problem, argument="name")
    with style.context(["default", figure_style.STYLE]):
        return painters[name](run)


def painters_of(run: RunData) -> dict[str, Painter]:
    """List the figures that a run has, by file name."""
    painters: dict[str, Painter] = {}
    for place in FIGURES:
        painters |= load(place, "a figure")(run)
    return painters


CAPTIONS = {
    "accuracy": "Errors of each condition: mean RMSE and mean Procrustes disparity over the "
    "structures. Bars are 95 % CI; of few structures, each has a small dot. Hollow markers, where "
    "there are any, are published numbers. Farther left is better.",
    "back-propagation": "RMSE against the steps that a robot takes, in the mean over all robots: a "
    "dot for each interval between two rounds, stated in joins, and a line for rounds that move "
    "equally many robots. Horizontal lines are conditions without rounds. Bars and bands are 95 % "
    "CI.",
    "convergence": "RMSE against iteration of the method: mean over the structures, with a band of "
    "one standard deviation where there are few lines. Of many, the first, best and worst have a "
    "color. A flat end shows that more iterations would "
    "not help. Iterations of different methods do not cost the same.",
    "error-against-height": "Error of each robot against its true height, a panel for each "
    "condition. A dot is a robot; its color is its join index, the order in which robots joined. "
    "Dots on the lower edge of a logarithmic axis have this error or less.",
    "error-along-growth": "Error of each robot against its place along the structure, a panel for "
    "each kind of structure or condition. A dot is a robot; its color is its join index, the order "
    "in which robots joined. Dots on the lower edge of a logarithmic axis have this error or less.",
    "grades": "RMSE by grade: conditions whose names end in a number share a panel, and each point "
    "of the sweep has a line. The dashed line is the first condition without a grade. Bars are "
    "95 % CI.",
    "building": "What robots build that navigate by the truth, or by what each condition estimates "
    "as they join. A flip is as planned if the robot then touches the one that it meant to reach. "
    "Bars are 95 % CI.",
    "joining": "RMSE of the robots that joined last, as many as a quarter of the smallest "
    "structure, against the number of robots by then. Lines are conditions; methods that place "
    "robots as they join have a second, dashed line for the same robots once all have joined.",
    "traffic": "RMSE against the bytes that a robot sends in the mean, those that it passes on for "
    "others included, both logarithmic: a marker for each condition whose robots localize "
    "themselves. Lines are conditions that have the log of all robots in one place. Bars and bands "
    "are 95 % CI. Farther left and lower is better.",
    "price-and-error": "Mean RMSE of all robots against the price of the sensors of 100 robots and "
    "of what they need around them, if the paper's Table I states it; below 200 USD the axis is "
    "linear. Each marker is a suite, its color and shape the way in which robots localize. Bars "
    "are 95 % CI. Farther left and lower is better.",
    "profiles": "RMSE of robots that are alike: by join index (order of joining), true height, "
    "hops (contacts on the shortest way to an anchor) and number of contacts. Bands cover the "
    "errors of 80 % of these robots. Numbers above count "
    "the robots of a point; hollow dots stand for few. Relative RMSE is the error of the vector "
    "between two robots. Of many series, each has a small panel with RMSE by hops alone.",
    "sd": "True structure, each robot colored by the standard deviation of its position that the "
    "method reports. It should resemble the errors.",
    "scaling": "Accuracy and cost against the number of robots N, on logarithmic axes. The legends "
    "state the power of N that fits all sizes, and the last two.",
    "shape": "Accuracy and structure by the robots: mean RMSE, floppy modes (motions that change "
    "no measurement in use), contacts with earlier robots, and height of the structure. Bars are "
    "95 % CI; gray stands for all conditions.",
    "contact-graph": "Contacts: each ball is a robot, colored by its hops from an anchor, and "
    "each rod joins two robots in contact.",
    "error": "True structure, each robot colored by the error of its estimated position.",
    "growth": "Growth of the structure, colored by join index, the order in which robots joined.",
    "sensed-force": "True structure, each robot colored by the force that it senses in its links, "
    "in weights of a dock.",
    "sizes": "Structures of every size at one scale, each robot colored by its error.",
    "structure": "True structure, colored by join index, the order in which robots joined.",
    "truth-and-estimate": "Estimated robots, orange, and true robots, translucent blue, where they "
    "are more than 0.3 R apart. If most are, balls stand for robots, and rods join true and "
    "estimated centers.",
}
"""Captions by file name; a longer name adds a sweep point or a case."""


def caption_of(name: str, case: str = "") -> str:
    """Describe a picture by the longest known part of its name.

    The rest of the name is a sweep point or a case; without a rest, the picture shows `case`.
    """
    known = max((key for key in CAPTIONS if f"{name}-".startswith(f"{key}-")), key=len, default="")
    rest = name.removeprefix(known).strip("-")
    shown = f"Case {case}." if case and not rest else f"Shown: {rest}." if known and rest else rest
    return " ".join(filter(None, [CAPTIONS.get(known, ""), shown]))
