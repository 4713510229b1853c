"""What pages state of results: a text for each mark, composed from `docs/results.csv`.

Numbers that no row of the file has, such as p of a paired test, stand outside marks.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from benchmarks import paper_facts
from benchmarks.paper_sentences import (
    RADII,
    VERDICTS,
    Facts,
    percents,
    reproduces,
    sentence_table,
    sentence_verdicts,
    verdict,
)
from benchmarks.result_texts import (
    BOTH,
    Result,
    Results,
    count,
    count_of,
    fixed,
    interval,
    kilobytes,
    kilobytes_interval,
    p_between,
    percent,
    small_p,
    span,
    table,
    tens,
    three_digits,
)
from tiswarm.base.errors import InputError
from tiswarm.evaluation.paper import PAPER

EPYC = "AMD EPYC family 26 model 2"
"""Kind of processor of most results, which docs/accuracy.md names."""

OLDER_EPYC = "AMD EPYC family 25 model 17"
"""Kind of processor of the paper's table, lossy channels, and own messages over 20 R."""

XEON = "Intel(R) Xeon(R) Processor family 6 model 167"
"""Kind of processor of errors on slopes."""

PLAIN_EPYC = f"{EPYC}, libraries without AVX2 and FMA"
"""The same processor with other numerical libraries."""

Statement = Callable[[Results], str]
"""A function that composes the text of a mark."""

STATEMENTS: dict[str, Statement] = {}
"""Functions that compose a text from results, by the name of its mark."""


def statement(name: str) -> Callable[[Statement], Statement]:
    """Register a function as what pages state at marks of a name."""

    def register(compose: Statement) -> Statement:
        STATEMENTS[name] = compose
        return compose

    return register


def texts_of(results: pd.DataFrame) -> dict[str, str]:
    """Compose the text of each mark from the rows of `read_results`.

    Raises:
        InputError: a result is missing.
    """
    indexed = Results(results)
    return {name: compose(indexed) for name, compose in STATEMENTS.items()}


# --- README.md and docs/accuracy.md -----------------------------------------------------------

ACCURACY = {
    "final contacts, ground, height | none": ("algorithm-1", "height"),
    "final contacts, ground | none": ("algorithm-1-no-height", "no-height"),
    "final contacts, ground, height | 1, 2 deg": ("algorithm-1-noisy", "noisy-height"),
    "walk contacts too (the default) | 1, 2 deg": ("", "noisy-walks"),
    "walk contacts and spawn positions too | 1, 2 deg": ("", "noisy-odometry"),
}
"""Conditions of Algorithm 1 and of `joint` in the scenario joint, by measurements and noise."""


def joint(
    results: Results, condition: str, structure: str, measure: str = "rmse_R", kind: str = EPYC
) -> Result:
    """Return a result of the scenario joint."""
    return results.of("joint", condition, f"structure.kind={structure}", measure, kind)


def on_every_kind(results: Results, condition: str, structure: str) -> str:
    """Write an RMSE of the scenario joint as all kinds of processors round it, to 0.1 R.

    Raises:
        InputError: fewer than two kinds have computed it, or these round otherwise.
    """
    kinds = results.kinds("joint", condition, f"structure.kind={structure}", "rmse_R")
    rounded = {fixed(joint(results, condition, structure, kind=k).mean, 1) for k in kinds}
    if len(kinds) < 2 or len(rounded) != 1:  # noqa: PLR2004
        problem = f"{condition}, {structure}: {len(kinds)} kinds of processors have {rounded}"
        raise InputError(f"{problem}; run it on two kinds, and state what both round to")
    return rounded.pop()


@statement("methods")
def _methods(results: Results) -> str:
    rows = [
        ("`virtual-force`", "contacts, heights, docks on the ground", "none", "algorithm-1"),
        ("`virtual-force`, all at once", "the same", "none", "algorithm-1-all-at-once"),
        ("`joint`", "the same", "none", "height"),
        (
            "`joint`",
            "the same, and walk contacts",
            "1 deg of tilt, 2 deg of yaw",
            "noisy-walks",
        ),
    ]
    return table(
        ["method", "measurements", "noise", *BOTH],
        [[*row, *(on_every_kind(results, condition, s) for s in BOTH)] for *row, condition in rows],
    )


@statement("structure-sizes")
def _structure_sizes(results: Results) -> str:
    rows = {
        "contacts with earlier robots, per robot": "contacts_per_robot",
        "rms radius [R]": "rms_radius_R",
    }
    return table(
        ["", *BOTH],
        [
            [label, *(fixed(joint(results, "height", s, measure).mean, 1) for s in BOTH)]
            for label, measure in rows.items()
        ],
    )


@statement("accuracy")
def _accuracy(results: Results) -> str:
    columns = ("Algorithm 1", "`joint`", "floppy")
    header = ["measurements beside non-overlap", "noise"]
    header += [f"{s}: {columns[0]}" if c == columns[0] else c for s in BOTH for c in columns]
    rows = []
    for label, (algorithm_1, condition) in ACCURACY.items():
        row = label.split(" | ")
        for structure in BOTH:
            row.append(_with_disparity(results, algorithm_1, structure, 3) if algorithm_1 else "-")
            row.append(_with_disparity(results, condition, structure, 4))
            floppy = joint(results, condition, structure, "floppy_modes").mean
            row.append(fixed(floppy, 1 if 0.0 < floppy < 1.0 else 0))
        rows.append(row)
    return table(header, rows)


def _with_disparity(results: Results, condition: str, structure: str, decimals: int) -> str:
    rmse = joint(results, condition, structure).mean
    disparity = joint(results, condition, structure, "procrustes_disparity").mean
    return f"{fixed(rmse, 2)} ({fixed(disparity, decimals)})"


@statement("accuracy-plain-libraries")
def _accuracy_plain_libraries(results: Results) -> str:
    pairs = []
    for structure in BOTH:
        rmse = [
            fixed(joint(results, condition, structure, kind=PLAIN_EPYC).mean, 2)
            for condition in ("algorithm-1", "height")
        ]
        pairs.append(" and ".join(rmse))
    return ", ".join(pairs)


def _half_widths(results: Results, condition: str) -> str:
    halves = [f"± {fixed(joint(results, condition, s).half_width, 2)} R" for s in BOTH]
    return f"{halves[0]} (tower) and {halves[1]} (cantilever)"


statement("accuracy-half-widths-algorithm-1")(lambda results: _half_widths(results, "algorithm-1"))
statement("accuracy-half-widths-joint")(lambda results: _half_widths(results, "height"))


def _accuracy_verdicts(results: Results, verdict: str) -> str:
    shares = [
        joint(results, condition, structure, verdict)
        for _, condition in ACCURACY.values()
        for structure in BOTH
        if EPYC in results.kinds("joint", condition, f"structure.kind={structure}", verdict)
    ]
    total = sum(share.structures for share in shares)
    return f"{sum(count_of(share) for share in shares)} of {total}"


statement("accuracy-converged")(lambda results: _accuracy_verdicts(results, "converged"))
statement("accuracy-consistent")(lambda results: _accuracy_verdicts(results, "consistent"))


def _rmse_of_both(results: Results, condition: str) -> str:
    tower, cantilever = (joint(results, condition, s).mean for s in BOTH)
    return f"{fixed(tower, 2)} R in towers and {fixed(cantilever, 2)} R in cantilevers"


statement("all-at-once")(lambda results: _rmse_of_both(results, "algorithm-1-all-at-once"))
statement("in-join-order")(lambda results: _rmse_of_both(results, "algorithm-1"))


@statement("all-at-once-not-converged")
def _all_at_once_not_converged(results: Results) -> str:
    shares = [joint(results, "algorithm-1-all-at-once", s, "converged") for s in BOTH]
    tower, cantilever = (share.structures - count_of(share) for share in shares)
    return f"{tower} of the towers and {cantilever} of the cantilevers"


# --- docs/paper.md and docs/notes/anchor-gap.md -----------------------------------------------

CUES = {
    "all cues": paper_facts.ALL,
    "no Z": paper_facts.NO_Z,
    "neither": paper_facts.NEITHER,
}
"""Conditions of the scenarios paper and paper-sets, in the order of the paper's table."""

OWN_AXIS = {
    cues: condition if condition == paper_facts.ALL else paper_facts.OWN_AXIS + condition
    for cues, condition in CUES.items()
}
"""The same if robots without Z start along their own z axis, not upward."""

PAPER_SETS = {
    "J = 1": (
        "{kind: tower, recruit_limit: 1}",
        "{kind: cantilever, recruit_limit: 1, anchor: 5.0, founders: 2}",
    ),
    "F = 17": (
        "{kind: tower, force_threshold: 17.0}",
        "{kind: cantilever, force_threshold: 17.0, anchor: 5.0, founders: 2}",
    ),
    "B = 1.5": (
        "{kind: tower, recruit_base: 1.5}",
        "{kind: cantilever, recruit_base: 1.5, anchor: 6.5, founders: 2}",
    ),
}
"""Towers and cantilevers of the scenario paper, by set; the first is nearest by its facts."""

SECOND_SET = "B = 1.5"
"""Set of the scenario paper that was grown from other seeds, too."""

OTHER_SETS = {
    "F = 10, 6.5 R: tiswarm's defaults": (
        "{kind: tower}",
        "{kind: cantilever, anchor: 6.5, founders: 2}",
    ),
    "F = 3.5, 5 R, `placed`": (
        "{kind: tower, force_threshold: 3.5}",
        "{kind: cantilever, force_threshold: 3.5, anchor: 5.0, founders: 2, spawn_behind: placed}",
    ),
}
"""Towers and cantilevers of the scenario paper-sets."""


@dataclass(frozen=True)
class PaperSet:
    """Results of one set of structures, each list in the order of `CUES`."""

    rmse: dict[str, list[Result]]
    """RMSE [R] by kind of structure."""

    disparity: dict[str, list[Result]]
    """Procrustes disparity [1] by kind of structure."""

    height: float
    """Mean height of towers [R]."""

    reach: float
    """Mean reach of cantilevers [R]."""

    beyond_edge: float
    """Mean share of a cantilever's robots beyond the edge [1]."""

    @classmethod
    def of(
        cls,
        results: Results,
        scenario: str,
        settings: tuple[str, str],
        cues: Mapping[str, str] = CUES,
    ) -> "PaperSet":
        """Collect the results of a scenario for the settings of both kinds of structures."""
        processor = EPYC if scenario == "paper-sets" else OLDER_EPYC
        tower, cantilever = settings

        def of(structure: str, condition: str, measure: str) -> Result:
            return results.of(scenario, condition, f"structure={structure}", measure, processor)

        def by_kind(measure: str) -> dict[str, list[Result]]:
            return {
                kind: [of(structure, condition, measure) for condition in cues.values()]
                for kind, structure in zip(BOTH, settings, strict=True)
            }

        return cls(
            rmse=by_kind("rmse_R"),
            disparity=by_kind("procrustes_disparity"),
            height=of(tower, "all-cues", "height_R").mean,
            reach=of(cantilever, "all-cues", "reach_R").mean,
            beyond_edge=of(cantilever, "all-cues", "beyond_edge").mean,
        )

    def rmse_ratios(self, kind: str, radius: float) -> list[float]:
        """Divide each RMSE by that of the paper, whose "robot radius" is `radius` [R]."""
        published = [cell.rmse_radii for key, cell in PAPER.items() if key[0] == kind]
        pairs = zip(self.rmse[kind], published, strict=True)
        return [result.mean / radius / radii for result, radii in pairs]

    def disparity_ratios(self, kind: str) -> list[float]:
        """Divide each disparity by that of the paper."""
        published = [cell.disparity for key, cell in PAPER.items() if key[0] == kind]
        pairs = zip(self.disparity[kind], published, strict=True)
        return [result.mean / disparity for result, disparity in pairs]

    def mean_factor(self, radius: float) -> float:
        """Return exp(mean |ln ratio|) of the twelve ratios."""
        ratios = [
            ratio
            for kind in BOTH
            for ratio in self.rmse_ratios(kind, radius) + self.disparity_ratios(kind)
        ]
        return math.exp(sum(abs(math.log(ratio)) for ratio in ratios) / len(ratios))


def paper_sets(results: Results, cues: Mapping[str, str] = CUES) -> dict[str, PaperSet]:
    """Collect the results of the three sets of the scenario paper."""
    return {
        name: PaperSet.of(results, paper_facts.SCENARIO, settings, cues)
        for name, settings in PAPER_SETS.items()
    }


def _both_starts(results: Results) -> tuple[list[PaperSet], list[PaperSet]]:
    """Collect the results of the three sets, from upward starts and from those on own axes."""
    upward, own_axis = ([*paper_sets(results, cues).values()] for cues in (CUES, OWN_AXIS))
    return upward, own_axis


def _paper_rows(
    upward: list[PaperSet],
    own_axis: list[PaperSet],
    row_of: Callable[[str, str, list[PaperSet], int], list[str]],
) -> list[list[str]]:
    """Write a row for each kind and condition; those without Z by both starts.

    Args:
        upward: Sets whose robots without Z start upward.
        own_axis: The same sets, with starts along robots' own axes.
        row_of: Writes a row from kind, label, sets, and number of the condition.
    """
    rows = []
    for kind in BOTH:
        for n, (cues, condition) in enumerate(CUES.items()):
            rows.append(row_of(kind, f"{kind}, {cues}", upward, n))
            if condition != paper_facts.ALL:
                rows.append(row_of(kind, f"{kind}, {cues}, own axis", own_axis, n))
    return rows


@statement("paper-rmse")
def _paper_rmse(results: Results) -> str:
    """Tabulate the RMSE of the three sets beside the paper's."""

    def row_of(kind: str, label: str, sets: list[PaperSet], n: int) -> list[str]:
        ratios = [[ours.rmse_ratios(kind, radius)[n] for ours in sets] for radius in RADII.values()]
        published = [cell.rmse_radii for key, cell in PAPER.items() if key[0] == kind][n]
        means = [interval(ours.rmse[kind][n], 2) for ours in sets]
        return [label, fixed(published, 2), *means, *map(_judged, ratios)]

    sets = [f"{name} [R]" for name in PAPER_SETS]
    by = [f"ratio by {radius}" for radius in RADII]
    return table(["", "paper", *sets, *by], _paper_rows(*_both_starts(results), row_of))


@statement("paper-disparity")
def _paper_disparity(results: Results) -> str:
    """Tabulate the disparity of the three sets beside the paper's."""

    def row_of(kind: str, label: str, sets: list[PaperSet], n: int) -> list[str]:
        ratios = [ours.disparity_ratios(kind)[n] for ours in sets]
        published = [cell.disparity for key, cell in PAPER.items() if key[0] == kind][n]
        means = [interval(ours.disparity[kind][n], 3) for ours in sets]
        return [label, fixed(published, 3), *means, _judged(ratios)]

    return table(["", "paper", *PAPER_SETS, "ratio"], _paper_rows(*_both_starts(results), row_of))


@statement("paper-second-seeds")
def _paper_second_seeds(results: Results) -> str:
    """Tabulate one set on other seeds beside the paper's numbers."""
    settings = PAPER_SETS[SECOND_SET]
    upward, own_axis = (
        [PaperSet.of(results, "paper-second", settings, cues)] for cues in (CUES, OWN_AXIS)
    )

    def row_of(kind: str, label: str, sets: list[PaperSet], n: int) -> list[str]:
        (ours,) = sets
        rmse, disparity = ours.rmse[kind][n], ours.disparity[kind][n]
        ratios = [ours.rmse_ratios(kind, radius)[n] for radius in RADII.values()]
        row = [label, interval(rmse, 2), *(fixed(ratio, 2) for ratio in ratios)]
        return [*row, interval(disparity, 3), fixed(ours.disparity_ratios(kind)[n], 2)]

    by = [f"ratio by {radius}" for radius in RADII]
    return table(["", "RMSE [R]", *by, "d", "ratio"], _paper_rows(upward, own_axis, row_of))


def _judged(ratios: Sequence[float]) -> str:
    """Write the span of ratios, and whether they reproduce a number of the paper."""
    return f"{span(ratios, 2)}, {verdict([reproduces(ratio) for ratio in ratios])}"


@statement("paper-counts")
def _paper_counts(results: Results) -> str:
    """Count the numbers of the paper's table, and its sentences, by verdict and start without Z."""
    starts = ((CUES, False), (OWN_AXIS, True))
    rows = []
    for radius, length in RADII.items():
        row = [f"RMSE by {radius}"]
        for cues, _ in starts:
            row += _counts(_verdicts(results, cues, lambda o, k, r=length: o.rmse_ratios(k, r)))
        rows.append(row)
    disparity = ["d"]
    sentences = ["sentences"]
    for cues, own_axis in starts:
        disparity += _counts(_verdicts(results, cues, PaperSet.disparity_ratios))
        sentences += _counts(sentence_verdicts(paper_facts_of(results), own_axis=own_axis))
    header = [f"{name}{axis}" for axis in ("", ", own axis") for name in VERDICTS]
    return table(["", *header], [*rows, disparity, sentences])


def _verdicts(
    results: Results, cues: Mapping[str, str], ratios: Callable[[PaperSet, str], list[float]]
) -> list[str]:
    """Judge the six numbers of a column of the paper's table."""
    sets = paper_sets(results, cues).values()
    return [
        verdict([reproduces(ratio) for ratio in of_number])
        for kind in BOTH
        for of_number in zip(*(ratios(ours, kind) for ours in sets), strict=True)
    ]


def _counts(verdicts: Sequence[str]) -> list[str]:
    """Count each of `VERDICTS`."""
    return [str(verdicts.count(name)) for name in VERDICTS]


@statement("paper-ratios")
def _paper_ratios(results: Results) -> str:
    """Tabulate the ratios of all sets, the least and the greatest of their conditions."""
    upward, own_axis = ([*paper_sets(results, cues).values()] for cues in (CUES, OWN_AXIS))
    rows = {"the three sets": upward, "the three sets, own axis": own_axis} | {
        name: [PaperSet.of(results, "paper-sets", settings)]
        for name, settings in OTHER_SETS.items()
    }
    cells = [
        [
            label,
            f"{span([100.0 * ours.beyond_edge for ours in sets], 0)} %",
            *(
                span([x for ours in sets for x in ours.rmse_ratios(kind, RADII[by])], 2)
                for kind in BOTH
                for by in ("R", "rho")
            ),
            span([x for ours in sets for kind in BOTH for x in ours.disparity_ratios(kind)], 2),
        ]
        for label, sets in rows.items()
    ]
    header = ["structures", "robots beyond the edge", "RMSE of towers by R"]
    return table([*header, "by rho", "of cantilevers by R", "by rho", "d"], cells)


def paper_facts_of(results: Results) -> dict[str, Facts]:
    """Collect the facts of the three sets of the scenario paper."""
    return {
        name: Facts(
            results, {k: f"structure={s}" for k, s in zip(BOTH, settings, strict=True)}, OLDER_EPYC
        )
        for name, settings in PAPER_SETS.items()
    }


statement("paper-sentences")(lambda results: sentence_table(paper_facts_of(results)))


@statement("paper-method")
def _paper_method(results: Results) -> str:
    """Set sentences on sensing and building beside numbers of other scenarios."""
    floppy = [
        ", ".join(fixed(joint(results, condition, s, "floppy_modes").mean, 1) for s in BOTH)
        for condition in ("no-height", "height", "noisy-walks")
    ]
    names = [
        ", ".join(
            fixed(results.of("vibration", c, f"structure.kind={s}", "rmse_R", EPYC).mean, 2)
            for s in BOTH
        )
        for c in ("known", "slots-8")
    ]
    truth, off, patient_truth, patient_off = (
        belief_error(results, "crossed", *of, patience=patience)
        for patience in (PATIENCE, DESIGNED_PATIENCE)
        for of in ((), ("independent", 2.0))
    )
    attached = (
        "bridges over 30 R that close if robots give up after 3, 32 steps without progress: "
        f"{count(off)}, {count(patient_off)} by positions that are 2 R off, "
        f"{count(truth)}, {count(patient_truth)} by true ones"
    )
    built_by = [
        fixed(built(results, "towers", by, "height_R").mean, 1)
        for by in ("the truth", "Algorithm 1")
    ]
    axes = (
        "`localization.flip_axes: 6` uses these, and removes "
        f"{STATEMENTS['flip-axes-gain'](results)} of the error by yaw noise"
    )
    motions = (
        f"free motions of 297, tower, cantilever: {floppy[0]} by contacts, {floppy[1]} with "
        f"heights, {floppy[2]} with contacts of earlier stances too"
    )
    rows = [
        [
            "II",
            '"predictable rotation angles"; "a small set of candidate configurations"',
            f"flips onto robots end at any angle, about one of six axes; {axes}",
        ],
        [
            "II",
            'orientation, docks, tangency and flips leave "an almost unique relative placement"',
            motions,
        ],
        [
            "III-A",
            '"vibration-based neighbor identification"',
            f"RMSE of `joint`: {names[0]} R if names are known, {names[1]} R with 8 time slots",
        ],
        ["V", 'errors of a dock diameter are "sufficient for reliable attachment"', attached],
        [
            "VI",
            'the method "operates during" self-assembly',
            f"towers of 60 robots that go by it rise {built_by[1]} R, by the truth {built_by[0]} R",
        ],
    ]
    return table(["section", "the paper", "here"], rows)


@statement("paper-own-axis")
def _paper_own_axis(results: Results) -> str:
    """Write by how much the RMSE without Z changes if robots start along their own axis."""
    upward, own_axis = (paper_sets(results, cues).values() for cues in (CUES, OWN_AXIS))

    def changes(kind: str, condition: int) -> str:
        pairs = zip(own_axis, upward, strict=True)
        means = [[ours.rmse[kind][condition].mean for ours in pair] for pair in pairs]
        change = [own / up - 1.0 for own, up in means]
        return percents([min(change), max(change)])

    no_z, neither = ([changes(kind, condition) for kind in BOTH] for condition in (1, 2))
    return f"towers {no_z[0]} (no Z), {neither[0]} (neither); cantilevers {no_z[1]}, {neither[1]}"


@statement("paper-settled")
def _paper_settled(results: Results) -> str:
    """Write the steps to within 10 % of the last RMSE."""
    sets = paper_facts_of(results).values()
    towers, cantilevers = (
        span([facts.mean(kind, "settled_step") for facts in sets], 0) for kind in BOTH
    )
    fewer = span(
        [
            facts.mean(kind, "settled_step", condition)
            for facts in sets
            for kind, condition in (
                ("tower", paper_facts.NO_Z),
                ("tower", paper_facts.NEITHER),
                ("cantilever", paper_facts.NO_Z),
            )
        ],
        0,
    )
    return f"{towers} steps in towers, {cantilevers} in cantilevers; with fewer cues {fewer}"


@statement("paper-structures")
def _paper_structures(results: Results) -> str:
    """Set what the text says of its structures beside the three sets."""
    sets = paper_facts_of(results).values()
    rows = [
        [
            "IV-B",
            "towers: goal at 65 robot radii",
            "height [R]; share of the goal by R, by rho",
            *(_of_goal(facts.mean("tower", "height_R"), 65.0) for facts in sets),
        ],
        [
            "IV-C",
            "cantilevers: goal 45 robot radii out",
            "reach [R]; share of the goal by R, by rho",
            *(_of_goal(facts.mean("cantilever", "reach_R"), 45.0) for facts in sets),
        ],
        [
            "IV-C",
            'a cantilever "projects horizontally"',
            "robots beyond the edge",
            *(percent(facts.mean("cantilever", "beyond_edge")) for facts in sets),
        ],
        [
            "IV-C 1, V",
            'cantilevers: the first on the anchor "often appears much later" (e.g., N ≈ 13)',
            "its number, median (quartiles)",
            *(_first_on_anchor(facts) for facts in sets),
        ],
        [
            "IV-C 1, V",
            'towers: robots 2 and 3 "attach immediately to the anchor"',
            "towers in which both do",
            *(percent(facts.mean("tower", "both_at_once")) for facts in sets),
        ],
    ]
    return table(["section", "the paper", "number", *PAPER_SETS], rows)


def _of_goal(size: float, goal: float) -> str:
    """Write a size [R] and its share of a goal in robot radii, by R and by rho."""
    shares = ", ".join(percent(size / goal / RADII[by]) for by in ("R", "rho"))
    return f"{fixed(size, 1)}; {shares}"


def _first_on_anchor(facts: Facts) -> str:
    """Write the number of the first robot on the anchor, which is robot 1."""
    median, low, high = (
        facts.mean("cantilever", which) + 1.0
        for which in ("first_median", "first_quartile", "third_quartile")
    )
    return f"{median:.0f} ({low:.0f} to {high:.0f})"


@statement("paper-sets")
def _paper_sets(results: Results) -> str:
    sets = paper_sets(results)
    sets |= {name: PaperSet.of(results, "paper-sets", s) for name, s in OTHER_SETS.items()}
    rows = []
    for label, ours in sets.items():
        row = [label, f"{fixed(ours.reach, 0)}, {fixed(ours.height, 0)}"]
        row.append(_ratios_of_both(lambda kind, o=ours: o.rmse_ratios(kind, RADII["rho"])))
        row.append(_ratios_of_both(ours.disparity_ratios))
        factors = [ours.mean_factor(RADII[radius]) for radius in ("rho", "R")]
        rows.append([*row, *(fixed(factor, 2) for factor in factors)])
    header = ["set", "reach, height [R]", "RMSE to the paper, radius = rho: towers, cantilevers"]
    header += ["d to the paper: towers, cantilevers", "mean factor off, rho", "R"]
    return table(header, rows)


def _ratios_of_both(ratios: Callable[[str], list[float]]) -> str:
    return ", ".join(" ".join(fixed(ratio, 2) for ratio in ratios(kind)) for kind in BOTH)


statement("paper-tower-rmse")(
    lambda results: span([ours.rmse["tower"][0].mean for ours in paper_sets(results).values()], 2)
)


GAP_SETS = {
    "force-3.5": "force_threshold: 3.5, recruit_base: 1.5, anchor: 6.5",
    "force-5": "force_threshold: 5.0, recruit_base: 1.5, anchor: 6.5",
    "force-10": "recruit_base: 1.5, anchor: 6.5",
    "force-17": "force_threshold: 17.0, recruit_base: 1.5, anchor: 6.5",
    "force-25": "force_threshold: 25.0, recruit_base: 1.5, anchor: 6.5",
    "anchor-2": "recruit_base: 1.5, anchor: 2.0",
    "anchor-3.5": "recruit_base: 1.5, anchor: 3.5",
    "anchor-5": "recruit_base: 1.5, anchor: 5.0",
}
"""Settings of the scenario anchor-gap, by the ends of the names of their texts."""


def _gap_rmse(settings: str) -> Statement:
    point = f"structure={{kind: cantilever, {settings}, founders: 2}}"
    return lambda results: three_digits(
        results.of("anchor-gap", "all-cues", point, "rmse_R", EPYC).mean
    )


for _name, _settings in GAP_SETS.items():
    statement(f"anchor-gap-{_name}")(_gap_rmse(_settings))


# --- docs/benchmarks.md -------------------------------------------------------------------------

LARGE = {
    ("tower", 300): ("goal_height: 94.0", "goal_height: 113.0, force_threshold: 35.0", 17),
    ("tower", 1_000): ("goal_height: 140.0", "goal_height: 206.0, force_threshold: 63.0", 32),
    ("tower", 3_000): ("goal_height: 202.0", "goal_height: 356.0, force_threshold: 110.0", 55),
    ("tower", 10_000): ("goal_height: 302.0", "goal_height: 650.0, force_threshold: 200.0", 100),
    ("cantilever", 300): ("goal_reach: 65.0", "goal_reach: 78.0, force_threshold: 35.0", 17),
    ("cantilever", 1_500): ("goal_reach: 110.0", "goal_reach: 174.0, force_threshold: 77.0", 39),
    ("cantilever", 3_000): ("goal_reach: 140.0", "goal_reach: 246.0, force_threshold: 110.0", 55),
    ("bridge", 1_000): ("gap: 80.0", "", 0),
    ("bridge", 1_500): ("", "gap: 100.0, force_threshold: 77.0", 39),
}
"""Settings of the scenario large-structures by the defaults and by its law, and its patience."""

LARGE_SIZES = {"tower": "height_R", "cantilever": "reach_R", "bridge": "crossed"}
"""What structures of the scenario large-structures reach."""

LARGE_SHARES = {"tower": "above_crowd", "cantilever": "beyond_edge", "bridge": "beyond_edge"}
"""The share of their robots that are beyond the crowd at their foot."""


LOCATED = (("tower", 300), ("cantilever", 300), ("tower", 1_000))
"""Structures of the scenario large-located: kind and robots."""


def large_point(kind: str, robots: int, *, by_law: bool) -> str:
    """Return the point of a structure of the scenario large-structures; empty if it has none."""
    default, law, patience = LARGE[kind, robots]
    settings = f"{law}, climb: {{patience: {patience}}}" if by_law and law else default
    return f"structure={{kind: {kind}, {settings}}}" if (law if by_law else default) else ""


def of_large(results: Results, point: str, measure: str) -> Result:
    """Return a result of the scenario large-structures."""
    return results.of("large-structures", "baseline", point, measure, OLDER_EPYC)


@statement("large-structures")
def _large_structures(results: Results) -> str:
    rows = []
    for kind, robots in LARGE:
        for by_law in (False, True):
            point = large_point(kind, robots, by_law=by_law)
            if not point:
                continue
            reached = of_large(results, point, LARGE_SIZES[kind])
            share = of_large(results, point, LARGE_SHARES[kind])
            rows.append(
                [
                    f"{kind}, {robots:,}",
                    "law" if by_law else "defaults",
                    f"{_goal(point):.0f} R",
                    f"{count(reached)} closed" if kind == "bridge" else f"{reached.mean:.0f} R",
                    percent(share.mean),
                    fixed(of_large(results, point, "tries_per_robot").mean, 0),
                    f"{of_large(results, point, 'peak_stress').mean:,.0f}",
                    str(reached.structures),
                ]
            )
    header = ["structure, robots", "F, patience", "goal or gap", "height or reach"]
    header += ["share beyond", "tries"]
    return table([*header, "peak stress [W / R^2]", "structures"], rows)


def _goal(point: str) -> float:
    """Read the goal, or the gap, of a point of the scenario large-structures [R]."""
    match = re.search(r"(?:goal_height|goal_reach|gap): ([\d.]+)", point)
    assert match is not None  # noqa: S101 - every structure has one
    return float(match[1])


@statement("large-located")
def _large_located(results: Results) -> str:
    """Tabulate mean errors in large structures."""
    rows = []
    for kind, robots in LOCATED:
        for by_law in (False, True):
            point = large_point(kind, robots, by_law=by_law)
            errors = [
                results.of("large-located", condition, point, "rmse_R", OLDER_EPYC)
                for condition in ("joint", "joint-final", "algorithm-1")
            ]
            rule = "law" if by_law else "defaults"
            means = [fixed(error.mean, 2) for error in errors]
            rows.append([f"{kind}, {robots:,}", rule, *means, str(errors[0].structures)])
    header = ["structure, robots", "F, patience", "`joint`", "`joint`, final contacts"]
    return table([*header, "Algorithm 1", "structures"], rows)


# --- docs/guides/closed-loop.md and docs/notes/measurements.md --------------------------------

NAVIGATION = {
    "the truth": ("truth", "online"),
    "`online`": ("estimate", "online"),
    "own messages": ("estimate", "messages"),
    "Algorithm 1": ("estimate", "algorithm-1"),
}
"""`navigate_by` and condition of the scenario closed-loop, by what its robots go by."""

ESTIMATES = tuple(NAVIGATION)[1:]
"""What robots of the scenario closed-loop go by if not by the truth."""

BUILT = {
    "towers": "{kind: tower}",
    "cantilevers": "{kind: cantilever}",
    "bridges over 20 R": "{kind: bridge, gap: 20.0}",
    "bridges over 30 R": "{kind: bridge, gap: 30.0}",
}
"""Structures of the scenario closed-loop."""


PATIENCE = 3
"""Patience of ReactiveBuild, the default."""

DESIGNED_PATIENCE = 32
"""Patience by which most bridges over 30 R closed on the seeds of a search."""

PATIENT_STRUCTURES = 64
"""Structures of a row of the scenario closed-loop, if no other number is stated."""


def built(results: Results, structures: str, by: str, measure: str, kind: str = EPYC) -> Result:
    """Return a result of the scenario closed-loop at the default patience."""
    return results.of(*_built_columns(structures, by, measure), kind)


def built_patiently(results: Results, by: str, measure: str) -> Result:
    """Return a result of bridges over 30 R at the patience of the search."""
    columns = _built_columns("bridges over 30 R", by, measure, DESIGNED_PATIENCE)
    return results.of(*columns, OLDER_EPYC)


def _built_columns(
    structures: str, by: str, measure: str, patience: int = PATIENCE
) -> tuple[str, str, str, str]:
    """Return scenario, condition, point and measure of a result of the scenario closed-loop."""
    navigate_by, condition = NAVIGATION[by]
    point = f"structure={BUILT[structures]}, structure.navigate_by={navigate_by}"
    return "closed-loop", condition, f"{point}, structure.climb.patience={patience}", measure


@statement("closed-loop")
def _closed_loop(results: Results) -> str:
    rows = []
    for by in NAVIGATION:
        row = [
            by,
            interval(built(results, "towers", by, "height_R"), 1),
            interval(built(results, "cantilevers", by, "reach_R"), 1),
        ]
        for bridges in ("bridges over 20 R", "bridges over 30 R"):
            share = built(results, bridges, by, "crossed")
            p = p_between(share, built(results, bridges, "the truth", "crossed"))
            row.append(count(share) if by == "the truth" else f"{count(share)} (p = {small_p(p)})")
        rows.append(row)
    header = ["robots go by", "height of towers [R]", "reach of cantilevers [R]"]
    return table([*header, "bridges over 20 R closed", "over 30 R closed"], rows)


@statement("closed-loop-patience")
def _closed_loop_patience(results: Results) -> str:
    """Tabulate what has been grown at the patience of the search, beside the default."""
    rows = []
    for by in NAVIGATION:
        columns = _built_columns("bridges over 30 R", by, "crossed", DESIGNED_PATIENCE)
        if not results.kinds(*columns):
            continue
        hasty = built(results, "bridges over 30 R", by, "crossed")
        patient, truth = (built_patiently(results, b, "crossed") for b in (by, "the truth"))
        p = "" if by == "the truth" else f" (p = {small_p(p_between(patient, truth))})"
        row = [by, count(hasty), f"{count(patient)}{p}", small_p(p_between(patient, hasty))]
        for measure, decimals in (("tries_per_robot", 1), ("failed_flips", 2)):
            if measure == "failed_flips" and by == "the truth":
                row.append("")  # flips that are planned by the truth do not fail
                continue
            pair = (
                built(results, "bridges over 30 R", by, measure),
                built_patiently(results, by, measure),
            )
            row.append(", ".join(fixed(result.mean, decimals) for result in pair))
        rows.append(row)
    header = ["robots go by", "closed, patience 3", f"patience {DESIGNED_PATIENCE}", "p of the two"]
    return table([*header, "tries of a robot", "failed flips for each one taken"], rows)


@statement("closed-loop-patient-sizes")
def _closed_loop_patient_sizes(results: Results) -> str:
    """Tabulate the sizes of structures at the patience of the search, beside the default."""
    rows = []
    for by in NAVIGATION:
        row = [by]
        for structures, measure in (("towers", "height_R"), ("cantilevers", "reach_R")):
            columns = _built_columns(structures, by, measure, DESIGNED_PATIENCE)
            row.append(interval(built(results, structures, by, measure), 1))
            if not results.kinds(*columns):
                row.append("")
                continue
            size = results.of(*columns, OLDER_EPYC)
            seeds = "" if size.structures == PATIENT_STRUCTURES else f", of {size.structures}"
            row.append(f"{interval(size, 1)}{seeds}")
        rows.append(row)
    patience = f"patience {DESIGNED_PATIENCE}"
    sizes = ["height of towers [R], patience 3", patience, "reach of cantilevers [R], patience 3"]
    return table(["robots go by", *sizes, f"{patience} "], rows)


PATIENCE_BUILT = {
    "bridges over 20 R": ("{kind: bridge, gap: 20.0}", "crossed"),
    "bridges over 30 R": ("{kind: bridge, gap: 30.0}", "crossed"),
    "bridges over 40 R, 100 robots": ("{kind: bridge, gap: 40.0}", "crossed"),
    "towers": ("{kind: tower}", "height_R"),
    "cantilevers": ("{kind: cantilever}", "reach_R"),
}
"""Structures of the scenario patience, and what they reach."""

PATIENT_RULES = {
    "F 10, patience 3": (10.0, 3),
    "16": (10.0, 16),
    "32": (10.0, 32),
    "F 15, patience 16": (15.0, 16),
    "32 ": (15.0, 32),
}
"""F and patience of the scenario patience, by the heading of a column."""

FIRST_SEEDS, SECOND_SEEDS = "0-63", "710000-710063"
"""Seeds of the scenario patience, and the second ones of bridges over 30 R."""


def patient(
    results: Results, structures: str, rule: tuple[float, int], measure: str, seeds: str
) -> Result:
    """Return a result of the scenario patience."""
    force, patience = rule
    point = (
        f"structure={PATIENCE_BUILT[structures][0]}, structure.climb.patience={patience}, "
        f"structure.force_threshold={force}"
    )
    return results.of("patience", "baseline", point, measure, OLDER_EPYC, seeds=seeds)


@statement("patience")
def _patience(results: Results) -> str:
    rows = []
    for structures, (_, reached) in PATIENCE_BUILT.items():
        row = [structures]
        for rule in PATIENT_RULES.values():
            found = patient(results, structures, rule, reached, FIRST_SEEDS)
            row.append(count(found) if reached == "crossed" else f"{interval(found, 1)} R")
        rows.append(row)
    bridges = "bridges over 30 R"
    second = [patient(results, bridges, r, "crossed", SECOND_SEEDS) for r in PATIENT_RULES.values()]
    rows.insert(2, [f"{bridges}, second seeds", *map(count, second)])
    for name, measure, decimals in (
        ("robots in the end", "joined", 0),
        ("tries of a robot", "tries_per_robot", 1),
        ("peak stress [W / R^2]", "peak_stress", 0),
    ):
        cells = [
            fixed(patient(results, bridges, rule, measure, FIRST_SEEDS).mean, decimals)
            for rule in PATIENT_RULES.values()
        ]
        rows.append([f"{bridges}: {name}", *cells])
    return table(["", *map(str.strip, PATIENT_RULES)], rows)


def _patient_bridges(seeds: str) -> Statement:
    """Write how many bridges over 30 R close by the default F and the patience of the search."""
    rule = (10.0, DESIGNED_PATIENCE)
    return lambda results: count(patient(results, "bridges over 30 R", rule, "crossed", seeds))


statement("patient-bridges")(_patient_bridges(FIRST_SEEDS))
statement("patient-bridges-second")(_patient_bridges(SECOND_SEEDS))


@statement("closed-loop-flips")
def _closed_loop_flips(results: Results) -> str:
    rows = []
    for structures in BUILT:
        for by in NAVIGATION:
            tries = fixed(built(results, structures, by, "tries_per_robot").mean, 1)
            row = [f"{structures}, {by}", tries, "", ""]
            if by in ESTIMATES:
                row[2] = fixed(built(results, structures, by, "failed_flips").mean, 2)
                row[3] = percent(built(results, structures, by, "flips_as_planned").mean)
            rows.append(row)
    header = ["structures, by what robots go by", "tries of a robot"]
    return table([*header, "failed flips for each one taken", "as planned"], rows)


@statement("closed-loop-beliefs")
def _closed_loop_beliefs(results: Results) -> str:
    errors = ("building", "newest", "final", "per_contact")
    rows = []
    for structures in BUILT:
        for by in ESTIMATES:
            row = [f"{structures}, {by}"]
            row += [
                fixed(built(results, structures, by, f"belief_{error}_R").mean, 2)
                for error in errors
            ]
            row.append(_final_answer(results, structures, by))
            for sent in ("belief_sent_B", "belief_worst_sent_B"):
                has_messages = by != "`online`"
                row.append(kilobytes(built(results, structures, by, sent)) if has_messages else "")
            rows.append(row)
    header = ["structures, by what robots go by", "while building", "newest robot"]
    header += ["after the last join", "between neighbors", "final answer"]
    return table([*header, "sent by a robot", "by the worst robot"], rows)


def _final_answer(results: Results, structures: str, by: str) -> str:
    """Write RMSE of the final answer; of own messages over 20 R another processor has it."""
    kinds = results.kinds(*_built_columns(structures, by, "rmse_R"))
    if not kinds:
        return ""
    kind = EPYC if EPYC in kinds else OLDER_EPYC
    return three_digits(built(results, structures, by, "rmse_R", kind).mean)


@statement("closed-loop-losses")
def _closed_loop_losses(results: Results) -> str:
    lost = []
    for structures, measure in (("towers", "height_R"), ("cantilevers", "reach_R")):
        truth = built(results, structures, "the truth", measure).mean
        lost += [
            100.0 * (1.0 - built(results, structures, by, measure).mean / truth)
            for by in ("`online`", "own messages")
        ]
    return f"{span(lost, 0)} %"


@statement("closed-loop-sent")
def _closed_loop_sent(results: Results) -> str:
    sent = [built(results, s, "own messages", "belief_sent_B").mean / 1e3 for s in BUILT]
    return f"{span(sent, 2)} kB"


@statement("closed-loop-worst-sent")
def _closed_loop_worst_sent(results: Results) -> str:
    sent = [built(results, s, "own messages", "belief_worst_sent_B").mean / 1e3 for s in BUILT]
    return f"{fixed(max(sent), 1)} kB"


@statement("closed-loop-newest")
def _closed_loop_newest(results: Results) -> str:
    ratios = [
        built(results, structures, by, "belief_newest_R").mean
        / built(results, structures, by, "belief_final_R").mean
        for structures in BUILT
        for by in ("`online`", "own messages")
    ]
    return f"{span(ratios, 1)} times"


@statement("closed-loop-online-final")
def _closed_loop_online_final(results: Results) -> str:
    return f"{interval(built(results, 'bridges over 20 R', '`online`', 'rmse_R'), 2)} R"


BELIEF_ERRORS = {
    ("independent", 0.5): "R",
    ("independent", 1.0): "R",
    ("independent", 1.5): "R",
    ("independent", 2.0): "R",
    ("shift", 1.0): "R",
    ("shift", 3.0): "R",
    ("turn", 0.1): "rad",
    ("turn", 0.2): "rad",
    ("turn", 0.4): "rad",
    ("adding-up", 0.2): "R",
    ("adding-up", 0.5): "R",
    ("adding-up", 1.0): "R",
}
"""Units of the sizes of the scenario belief-errors, by kind and size."""


def belief_error(
    results: Results, measure: str, kind: str = "", size: float = 0.0, patience: int = PATIENCE
) -> Result:
    """Return a result of the scenario belief-errors; that of the truth without a kind."""
    processor = EPYC if patience == PATIENCE else OLDER_EPYC
    return results.of(*_belief_columns(kind, size, patience), measure, processor)


def _belief_columns(kind: str, size: float, patience: int) -> tuple[str, str, str]:
    """Return scenario, condition and point of results of the scenario belief-errors."""
    error = f", navigate_by: error, belief_error: {{kind: {kind}, size: {size}}}" if kind else ""
    point = f"structure={{kind: bridge, gap: 30.0{error}}}, structure.climb.patience={patience}"
    return "belief-errors", "baseline", point


@statement("belief-errors")
def _belief_errors(results: Results) -> str:
    rows = []
    for (kind, size), unit in BELIEF_ERRORS.items():
        closed = belief_error(results, "crossed", kind, size)
        rows.append(
            [
                kind,
                f"{size:g} {unit}",
                fixed(belief_error(results, "belief_final_R", kind, size).mean, 2),
                fixed(belief_error(results, "belief_per_contact_R", kind, size).mean, 2),
                count(closed),
                small_p(p_between(closed, belief_error(results, "crossed"))),
                fixed(belief_error(results, "tries_per_robot", kind, size).mean, 2),
                *_patient_errors(results, kind, size),
            ]
        )
    header = ["error of a robot", "size", "RMSE [R]", "between neighbors [R]"]
    return table([*header, *2 * ["closed", "p", "tries"]], rows)


def _patient_errors(results: Results, kind: str, size: float) -> list[str]:
    """Write bridges closed at the patience of the search, p against the truth, and tries.

    Cells are empty where nothing was grown.
    """
    if not results.kinds(*_belief_columns(kind, size, DESIGNED_PATIENCE), "crossed"):
        return 3 * [""]
    closed, truth, tries = (
        belief_error(results, measure, *of, patience=DESIGNED_PATIENCE)
        for measure, of in (
            ("crossed", (kind, size)), ("crossed", ()), ("tries_per_robot", (kind, size)),
        )
    )  # fmt: skip
    return [count(closed), small_p(p_between(closed, truth)), fixed(tries.mean, 1)]


NEIGHBOR_ERRORS = {
    "0.7": (("independent", 0.5), ("turn", 0.2), ("adding-up", 0.5)),
    "1.4": (("independent", 1.0), ("turn", 0.4), ("adding-up", 1.0)),
    "2.1": (("independent", 1.5),),
}
"""Kinds and sizes of `BELIEF_ERRORS`, by the greatest error between neighbors [R]."""


def _closed_at(errors: Sequence[tuple[str, float]], patience: int = PATIENCE) -> Statement:
    """Write how many bridges closed with the least and the greatest number: `11 to 20`."""

    def compose(results: Results) -> str:
        numbers = [
            count_of(belief_error(results, "crossed", kind, size, patience))
            for kind, size in errors
            if results.kinds(*_belief_columns(kind, size, patience), "crossed")
        ]
        return span(numbers, 0)

    return compose


for _size, _errors in NEIGHBOR_ERRORS.items():
    statement(f"belief-errors-at-{_size}")(_closed_at(_errors))
    statement(f"belief-errors-patient-at-{_size}")(_closed_at(_errors, DESIGNED_PATIENCE))

statement("belief-errors-truth")(lambda results: count(belief_error(results, "crossed")))
statement("belief-errors-patient-truth")(
    lambda results: count(belief_error(results, "crossed", patience=DESIGNED_PATIENCE))
)
statement("belief-errors-patient-independent-2")(
    lambda results: count(belief_error(results, "crossed", "independent", 2.0, DESIGNED_PATIENCE))
)
statement("belief-errors-truth-tries")(
    lambda results: f"{fixed(belief_error(results, 'tries_per_robot').mean, 2)} tries"
)
statement("belief-errors-independent-2")(
    lambda results: count(belief_error(results, "crossed", "independent", 2.0))
)


# --- docs/guides/distributed.md ---------------------------------------------------------------

MESSAGES = {
    "`joint`, whole log": "joint",
    "default, by touch": "touch",
    "`base`, by touch": "base",
    "Algorithm 1 by radio, poses at each join": "algorithm-1",
    "Algorithm 1 by touch, no undocked repulsion": "algorithm-1-local",
}
"""Conditions of the scenario between."""

LOSSES = {
    "0 %": "touch",
    "10 %": "touch-loss-10",
    "20 %": "touch-loss-20",
    "30 %": "touch-loss-30",
    "30 % in bursts": "touch-bursts",
}
"""Conditions of the scenario between, by the share that is lost."""

CHANNELS = {
    "touch": "touch",
    "touch, 30 % lost": "touch-loss-30",
    "touch, 30 % lost in bursts of 8 rounds": "touch-bursts",
    "touch, delay of 5 rounds": "touch-delay",
    "radio, all in reach": "radio",
    "radio, 8 R": "radio-8-R",
    "radio, 8 R, 30 % lost": "radio-8-R-loss-30",
    "radio, 8 R, 30 % lost in bursts of 8 rounds": "radio-8-R-bursts",
    "radio, 8 R, 16 slots": "radio-8-R-slots",
}
"""Conditions of `joiner` in the scenario channels."""

POSE_CHANNELS = {
    "radio, all in reach, poses of all at each join": "algorithm-1",
    "the same, 30 % lost": "algorithm-1-loss-30",
    "the same, 30 % lost in bursts of 8 rounds": "algorithm-1-bursts",
    "the same, 16 slots": "algorithm-1-slots",
    "radio, 8 R, poses if asked": "algorithm-1-asked",
    "that, 30 % lost": "algorithm-1-asked-loss-30",
    "that, 30 % lost in bursts of 8 rounds": "algorithm-1-asked-bursts",
    "that, 16 slots": "algorithm-1-asked-slots",
    "touch, no undocked repulsion": "algorithm-1-touch",
}
"""Conditions of `algorithm-1` in the scenario channels."""

PROTOCOLS = {
    "all three known": "known",
    "learned ways": "learned",
    "timers of 64 rounds": "timer-64",
    "timers of 16 rounds": "timer-16",
    "timers of 4 rounds": "timer-4",
    "joins 10 rounds apart": "joins-10",
    "joins 1 round apart": "joins-1",
    "learned ways, timers of 64 rounds, joins 10 rounds apart": "without",
    "all three known, 30 % lost": "known-loss-30",
    "none of the three, 30 % lost": "without-loss-30",
}
"""Conditions of the scenario protocol, by what pages call them."""

ROBOTS_SEND = ["a robot sends [kB]", "worst robot [kB]"]


def between(
    results: Results, condition: str, structure: str, measure: str, kind: str = EPYC
) -> Result:
    """Return a result of the scenario between."""
    return results.of("between", condition, f"structure.kind={structure}", measure, kind)


def of_channel(
    results: Results, condition: str, measure: str, scenario: str = "channels"
) -> Result:
    """Return a result of the scenario channels, or of another one without a sweep."""
    return results.of(scenario, condition, "", measure, OLDER_EPYC)


@statement("between")
def _between(results: Results) -> str:
    rows = []
    for label, condition in MESSAGES.items():
        row = [
            label,
            _of_both(results, condition, "rmse_R", _two_decimals_interval),
            _of_both(results, condition, "rmse_per_contact_R", _two_decimals),
        ]
        if condition == "joint":  # nobody sends anything
            rows.append([*row, "", "", "", ""])
            continue
        is_joiner = not condition.startswith("algorithm-1")
        write_sent = kilobytes_interval if is_joiner else kilobytes  # poses have one size
        row.append(_of_both(results, condition, "sent_B", write_sent))
        row.append(_of_both(results, condition, "worst_sent_B", write_sent))
        row.append(_of_both(results, condition, "worst_memory_B", kilobytes))
        row.append(_of_both(results, condition, "rounds", tens) if is_joiner else "")
        rows.append(row)
    header = ["", "RMSE [R], tower, cantilever", "at one hop [R]", *ROBOTS_SEND]
    return table([*header, "stored by the fullest [kB]", "rounds"], rows)


def _of_both(results: Results, condition: str, measure: str, write: Callable[[Result], str]) -> str:
    """Write a measure of towers and of cantilevers."""
    return ", ".join(write(between(results, condition, s, measure)) for s in BOTH)


def _two_decimals(result: Result) -> str:
    return fixed(result.mean, 2)


def _two_decimals_interval(result: Result) -> str:
    return interval(result, 2)


def _radio(measure: str, write: Callable[[Result], str]) -> Statement:
    return lambda results: _of_both(results, "radio", measure, write)


statement("radio-rmse")(_radio("rmse_R", _two_decimals_interval))
statement("radio-rmse-one-hop")(_radio("rmse_per_contact_R", _two_decimals))
statement("radio-sent")(_radio("sent_B", kilobytes_interval))
statement("radio-worst-sent")(_radio("worst_sent_B", kilobytes_interval))


@statement("losses")
def _losses(results: Results) -> str:
    rows = []
    for structure in BOTH:
        for lost, condition in LOSSES.items():
            columns = (results, condition, structure)
            rows.append(
                [
                    f"{lost}, {structure}s",
                    interval(between(*columns, "rmse_R", OLDER_EPYC), 2),
                    fixed(between(*columns, "rmse_per_contact_R", OLDER_EPYC).mean, 2),
                    kilobytes_interval(between(*columns, "sent_B", OLDER_EPYC)),
                    kilobytes_interval(between(*columns, "worst_sent_B", OLDER_EPYC)),
                    tens(between(*columns, "rounds", OLDER_EPYC)),
                ]
            )
    return table(["lost", "RMSE [R]", "at one hop [R]", *ROBOTS_SEND, "rounds"], rows)


@statement("channels")
def _channels(results: Results) -> str:
    rows = [_channel_row(results, *item, decimals=2) for item in CHANNELS.items()]
    return table(["channel", "RMSE [R]", *ROBOTS_SEND, "rounds"], rows)


@statement("protocol")
def _protocol(results: Results) -> str:
    rows = []
    for label, condition in PROTOCOLS.items():
        columns = results, condition
        rows.append(
            [
                label,
                interval(of_channel(*columns, "rmse_R", "protocol"), 2),
                f"{fixed(100.0 * of_channel(*columns, 'located', 'protocol').mean, 1)} %",
                interval(of_channel(*columns, "rmse_located_R", "protocol"), 2),
                *(
                    kilobytes(of_channel(*columns, measure, "protocol"))
                    for measure in ("sent_B", "worst_sent_B", "worst_memory_B")
                ),
                tens(of_channel(*columns, "rounds", "protocol")),
            ]
        )
    header = ["robots have", "RMSE [R]", "located", "RMSE of located [R]", *ROBOTS_SEND]
    return table([*header, "stored by the fullest [kB]", "rounds"], rows)


@statement("protocol-errors")
def _protocol_errors(results: Results) -> str:
    """Write the errors of robots without what they usually have."""

    def rmse(condition: str) -> str:
        return interval(of_channel(results, condition, "rmse_R", "protocol"), 2)

    return (
        f"learned ways {rmse('learned')} R for {rmse('known')} R; timers of 4 rounds "
        f"{rmse('timer-4')} R; joins 10 rounds apart {rmse('joins-10')} R; all three with 30 % of "
        f"transmissions lost {rmse('without-loss-30')} R"
    )


@statement("pose-channels")
def _pose_channels(results: Results) -> str:
    rows = [_channel_row(results, *item, decimals=1) for item in POSE_CHANNELS.items()]
    return table(["Algorithm 1 by", "RMSE [R]", *ROBOTS_SEND, "rounds"], rows)


def _channel_row(results: Results, label: str, condition: str, *, decimals: int) -> list[str]:
    """Write a row; poses that nobody repeats take no rounds worth a number."""
    repeats = not condition.startswith("algorithm-1") or condition.endswith(
        ("-loss-30", "-bursts", "-slots")
    )
    return [
        label,
        interval(of_channel(results, condition, "rmse_R"), decimals),
        kilobytes(of_channel(results, condition, "sent_B")),
        kilobytes(of_channel(results, condition, "worst_sent_B")),
        tens(of_channel(results, condition, "rounds")) if repeats else "",
    ]


def _times(numerator: Result, denominator: Result) -> float:
    return numerator.mean / denominator.mean


def _ratios_between(condition: str, reference: str, measure: str, decimals: int) -> Statement:
    """Write how many times the reference a measure is: `1.7 and 1.4` of towers, cantilevers."""

    def compose(results: Results) -> str:
        ratios = [
            _times(between(results, condition, s, measure), between(results, reference, s, measure))
            for s in BOTH
        ]
        return " and ".join(fixed(ratio, decimals) for ratio in ratios)

    return compose


def _sends(condition: str) -> Statement:
    """Write the bytes that robots of both structures send, to 0.01 kB: `0.86 kB`."""

    def compose(results: Results) -> str:
        sent = [between(results, condition, s, "sent_B").mean / 1e3 for s in BOTH]
        return f"{span(sent, 2)} kB"

    return compose


statement("algorithm-1-sends")(_sends("algorithm-1"))
statement("algorithm-1-local-sends")(_sends("algorithm-1-local"))
statement("touch-to-joint")(_ratios_between("touch", "joint", "rmse_R", 1))
statement("base-to-joint")(_ratios_between("base", "joint", "rmse_R", 1))
statement("algorithm-1-to-touch")(_ratios_between("algorithm-1", "touch", "rmse_R", 0))


def _losses_to_none(measure: str, conditions: Sequence[str]) -> Statement:
    """Write how many times the value without losses a measure is, by condition."""

    def compose(results: Results) -> str:
        spans = []
        for condition in conditions:
            ratios = [
                _times(
                    between(results, condition, s, measure, OLDER_EPYC),
                    between(results, "touch", s, measure, OLDER_EPYC),
                )
                for s in BOTH
            ]
            spans.append(span(ratios, 1))
        *first, last = spans
        return f"{', '.join(first)} and {last}" if first else last

    return compose


_SINGLE_LOSSES = ("touch-loss-10", "touch-loss-20", "touch-loss-30")
statement("loss-bytes")(_losses_to_none("sent_B", _SINGLE_LOSSES))
statement("loss-rounds")(_losses_to_none("rounds", _SINGLE_LOSSES))
statement("burst-bytes")(_losses_to_none("sent_B", ["touch-bursts"]))
statement("burst-rounds")(_losses_to_none("rounds", ["touch-bursts"]))


def _channel_losses(measure: str, loss: str) -> Statement:
    """Write how many times the value without losses a measure is, by touch and by radio."""

    def compose(results: Results) -> str:
        ratios = [
            _times(
                of_channel(results, f"{channel}-{loss}", measure),
                of_channel(results, channel, measure),
            )
            for channel in ("touch", "radio-8-R")
        ]
        return " and ".join(fixed(ratio, 1) for ratio in ratios)

    return compose


@statement("poses-if-asked-sends")
def _poses_if_asked_sends(results: Results) -> str:
    return f"{fixed(of_channel(results, 'algorithm-1-asked', 'sent_B').mean / 1e3, 2)} kB"


statement("channel-burst-bytes")(_channel_losses("sent_B", "bursts"))
statement("channel-loss-rounds")(_channel_losses("rounds", "loss-30"))
statement("channel-burst-rounds")(_channel_losses("rounds", "bursts"))


# --- docs/notes/orientations.md ---------------------------------------------------------------


@statement("flip-axes")
def _flip_axes(results: Results) -> str:
    rows = []
    for yaw in (2, 5, 10):
        row = [str(yaw)]
        for structure in BOTH:
            pair = [
                (condition, f"structure.kind={structure}")
                for condition in (f"yaw-{yaw}", f"yaw-{yaw}-flips")
            ]
            row += [interval(results.of("flips", *at, "rmse_R", EPYC), 3) for at in pair]
            shares = (100.0 * results.of("flips", *at, "consistent", EPYC).mean for at in pair)
            row.append(f"{', '.join(fixed(share, 0) for share in shares)} %")
        rows.append(row)
    header = ["yaw noise [deg]"]
    for structure in BOTH:
        header += [f"{structure}s: sensed", "fitted", "consistent"]
    return table(header, rows)


@statement("flip-axes-gain")
def _flip_axes_gain(results: Results) -> str:
    gains = []
    for yaw in (2, 5, 10):
        for structure in BOTH:
            point = f"structure.kind={structure}"
            sensed = results.of("flips", f"yaw-{yaw}", point, "rmse_R", EPYC).mean
            fitted = results.of("flips", f"yaw-{yaw}-flips", point, "rmse_R", EPYC).mean
            gains.append(100.0 * (1.0 - fitted / sensed))
    return f"{span(gains, 0)} %"


VIBRATION = {
    "names-known": "known",
    "names-64": "slots-64",
    "names-32": "slots-32",
    "names-16": "slots-16",
    "names-8": "slots-8",
}
"""Conditions of the scenario vibration, by the beginnings of the names of their texts."""


def _of_names(condition: str, structure: str) -> Statement:
    point = f"structure.kind={structure}"
    return lambda results: interval(results.of("vibration", condition, point, "rmse_R", EPYC), 2)


for _name, _condition in VIBRATION.items():
    for _structure in BOTH:
        statement(f"{_name}-{_structure}")(_of_names(_condition, _structure))


SLOPES = {
    "plane": "",
    "plane, docks on it not listed": ", terrain: [{kind: plane, pitch_deg: 360.0}]",
    "slope of 10 deg": ", terrain: [{kind: plane, pitch_deg: 10.0}]",
    "slope of 20 deg": ", terrain: [{kind: plane, pitch_deg: 20.0}]",
    "hill": (
        ", terrain: [{kind: plane}, {kind: sphere, position: [0.0, 0.0, -40.0], radius: 60.0}]"
    ),
    "rubble": (
        ", terrain: [{kind: plane}, {kind: mesh, file: terrain/rubble.stl, resolution: 0.5}]"
    ),
}
"""Grounds of the scenario slopes, by their names: ends of the names of its points."""


@statement("slopes")
def _slopes(results: Results) -> str:
    rows = []
    for name, end in SLOPES.items():
        point = f"structure={{kind: tower{end}}}"
        rmse, contacts, consistent = (
            results.of("slopes", "baseline", point, measure, XEON)
            for measure in ("rmse_R", "contacts_per_robot", "consistent")
        )
        rows.append([name, interval(rmse, 2), fixed(contacts.mean, 2), count(consistent)])
    return table(["ground", "RMSE [R]", "contacts of a robot", "consistent"], rows)
