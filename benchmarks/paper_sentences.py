"""What the paper says in sentences, beside what the three sets of `scenarios/paper.yaml` show.

Every number is a result of `docs/results.csv`, and every verdict follows from the numbers by one
rule, so a fresh run of the scenario rewrites the table.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from benchmarks.paper_facts import ALL, NEITHER, NO_Z, OWN_AXIS, THIRDS
from benchmarks.result_texts import BOTH, Result, Results, fixed, percent, small_p, table
from tiswarm.base.robot import FIREANT_RHO
from tiswarm.evaluation.tables import DOCK_DIAMETER

RADII = {"R": 1.0, "rho": FIREANT_RHO, "rho + R": FIREANT_RHO + 1.0}
"""What the paper's "robot radius" may be [R]."""

RMSE, DISPARITY = "rmse_R", "procrustes_disparity"

CHANCE = 0.05
"""Level of tests."""

WITHIN = 0.2
"""Largest relative difference at which a number of the paper counts as reproduced."""

LITTLE = 0.05
"""Largest relative change that counts as little."""

VERDICTS = ("holds", "depends", "does not hold")
"""Verdicts of `verdict`."""

DIAMETERS = 3.0
"""Largest error "on the order of one dock diameter" [diameters]: 3.91 rho are 2.9."""

_LEAST_RADII = 0.7
"""The paper's least RMSE of a tower ["robot radii"]."""


@dataclass(frozen=True)
class Facts:
    """Results of one set of structures."""

    results: Results
    points: dict[str, str]
    """Point of the sweep by kind of structure."""
    processor: str
    own_axis: bool = False
    """Whether robots without Z start along their own z axis, not upward."""

    def of(self, kind: str, measure: str, condition: str = ALL) -> Result:
        """Return a result of towers or cantilevers."""
        if self.own_axis and condition != ALL:
            condition = OWN_AXIS + condition
        return self.results.of("paper", condition, self.points[kind], measure, self.processor)

    def mean(self, kind: str, measure: str, condition: str = ALL) -> float:
        """Return the mean of a result."""
        return self.of(kind, measure, condition).mean

    def growth(self, kind: str, condition: str, before: str, measure: str = RMSE) -> float:
        """Return by how much a mean grows from one condition to another, relative to the first."""
        return self.mean(kind, measure, condition) / self.mean(kind, measure, before) - 1.0

    def p(self, kind: str, condition: str, before: str, measure: str = RMSE) -> float:
        """Return p of a paired test of two conditions, the second one with one or all cues more."""
        end = "p_all" if before == ALL else "p"
        return self.mean(kind, f"{measure}_{end}", condition)


class Finding(NamedTuple):
    """What one set shows."""

    number: str
    """The number that decides, as a cell of the table."""
    holds: bool
    """Whether the sentence holds of it."""


Judge = Callable[[Facts], Finding]
"""Judges a sentence by one set."""


class Sentence(NamedTuple):
    """A sentence of the paper."""

    section: str
    says: str
    """What it says."""
    number: str
    """What the numbers are."""
    judge: Judge
    """Judge it by one set."""


def _grows(kind: str, condition: str, before: str, *measures: str) -> Judge:
    """Hold if all measures grow by more than chance."""

    def judge(facts: Facts) -> Finding:
        growth = [facts.growth(kind, condition, before, measure) for measure in measures]
        p = [facts.p(kind, condition, before, measure) for measure in measures]
        number = f"{percents(growth)} (p {', '.join(small_p(value) for value in p)})"
        return Finding(number, min(growth) > 0.0 and max(p) < CHANCE)

    return judge


def _hardly_changes(facts: Facts) -> Finding:
    """Hold if errors of cantilevers change by no more than `LITTLE`."""
    growth = facts.growth("cantilever", NEITHER, NO_Z)
    p = facts.p("cantilever", NEITHER, NO_Z)
    return Finding(f"{100 * growth:+.1f} % (p {small_p(p)})", abs(growth) <= LITTLE)


def _least(facts: Facts) -> Finding:
    least = facts.mean("tower", "rmse_least_R") / _LEAST_RADII
    ratios = [least / radius for radius in RADII.values()]
    number = ", ".join(fixed(ratio, 2) for ratio in ratios)
    return Finding(number, any(reproduces(ratio) for ratio in ratios))


def _varies_less(facts: Facts) -> Finding:
    spread = [facts.mean("tower", f"error_sd_{third}_R") for third in THIRDS]
    return Finding(_lengths(spread), spread[0] > max(spread[1:]))


def _narrows(facts: Facts) -> Finding:
    share = facts.mean("tower", "narrows")
    return Finding(percent(share), share > 0.5)  # noqa: PLR2004 - most towers


def _follows_order(*kinds: str, expected: bool) -> Judge:
    """Hold if the correlation of errors with the join order is there in all kinds, or in none."""

    def judge(facts: Facts) -> Finding:
        correlations = [facts.of(kind, "join_correlation") for kind in kinds]
        is_there = [abs(result.mean) > result.half_width for result in correlations]
        return Finding(_intervals(correlations), all(there == expected for there in is_there))

    return judge


def _accumulates(kind: str, *, expected: bool) -> Judge:
    """Hold if errors grow with the contacts from the anchor, or do not."""

    def judge(facts: Facts) -> Finding:
        correlation = facts.of(kind, "hops_correlation")
        grows = correlation.mean > correlation.half_width
        return Finding(_intervals([correlation]), grows == expected)

    return judge


def _largest(facts: Facts) -> Finding:
    rmse = [facts.mean("tower", RMSE, condition) for condition in (ALL, NO_Z, NEITHER)]
    p = facts.p("tower", NEITHER, NO_Z)
    number = f"{_lengths(rmse)} (p {small_p(p)})"
    return Finding(number, rmse[2] > max(rmse[:2]) and p < CHANCE)


def _more_critical(facts: Facts) -> Finding:
    steps = ((NO_Z, ALL), (NEITHER, NO_Z))
    growth = [facts.growth("tower", *step, DISPARITY) for step in steps]
    return Finding(percents(growth), growth[1] > growth[0])


def _weaker_in_cantilevers(facts: Facts) -> Finding:
    growth = [facts.growth(kind, NO_Z, ALL) for kind in BOTH]
    return Finding(percents(growth), growth[1] < growth[0])


def _proportional(kind: str, condition: str, before: str) -> Judge:
    """Hold if disparity and RMSE both grow, and neither more than twice as much as the other."""

    def judge(facts: Facts) -> Finding:
        growth = [facts.growth(kind, condition, before, measure) for measure in (RMSE, DISPARITY)]
        least, most = sorted(growth)
        return Finding(percents(growth), least > 0.0 and most <= 2.0 * least)

    return judge


def _harder_cantilevers(facts: Facts) -> Finding:
    tower, cantilever = (facts.of(kind, RMSE) for kind in BOTH)
    apart = cantilever.mean - cantilever.half_width > tower.mean + tower.half_width
    return Finding(_lengths([tower.mean, cantilever.mean]), apart)


def _early_are_best(kind: str, *, expected: bool) -> Judge:
    """Hold if early robots err less than the others, or do not."""

    def judge(facts: Facts) -> Finding:
        early, late = (facts.mean(kind, f"{part}_error_R") for part in ("early", "late"))
        return Finding(_lengths([early, late]), (early < late) == expected)

    return judge


def _wider(facts: Facts) -> Finding:
    sd = [facts.mean("cantilever", "rmse_sd_R", condition) for condition in (ALL, NO_Z)]
    return Finding(_lengths(sd), sd[1] > sd[0])


def _bands_overlap(facts: Facts) -> Finding:
    """Hold if the bands of mean ± sd have more than half of the narrower one in common."""
    means, sds = (
        [facts.mean("cantilever", measure, condition) for condition in (NO_Z, NEITHER)]
        for measure in (RMSE, "rmse_sd_R")
    )
    bottoms, tops = (
        [mean + sign * sd for mean, sd in zip(means, sds, strict=True)] for sign in (-1.0, 1.0)
    )
    share = max(0.0, min(tops) - max(bottoms)) / (2.0 * min(sds))
    return Finding(percent(share), share > 0.5)  # noqa: PLR2004 - largely


def _rarer(facts: Facts) -> Finding:
    near = [facts.mean(kind, "near_docks") for kind in BOTH]
    return Finding(", ".join(fixed(value, 2) for value in near), near[1] < near[0])


def _collapses(facts: Facts) -> Finding:
    pairs = [facts.mean("tower", "collapsed_docks", condition) for condition in (NO_Z, NEITHER)]
    return Finding(", ".join(fixed(value, 2) for value in pairs), pairs[1] > pairs[0])


def _near_one_diameter(facts: Facts) -> Finding:
    errors = [facts.mean(kind, RMSE) / DOCK_DIAMETER for kind in BOTH]
    return Finding(", ".join(fixed(error, 1) for error in errors), max(errors) <= DIAMETERS)


def percents(growth: Sequence[float]) -> str:
    """Write relative changes in percent: `+21, 0, -3 %`."""
    rounded = [round(100.0 * value) for value in growth]  # -0.4 is no -0
    return ", ".join(f"{change:+d}" if change else "0" for change in rounded) + " %"


def _lengths(values: Sequence[float]) -> str:
    return ", ".join(fixed(value, 2) for value in values) + " R"


def _intervals(results: Sequence[Result]) -> str:
    return ", ".join(f"{fixed(r.mean, 2)} ± {fixed(r.half_width, 2)}" for r in results)


SENTENCES = (
    Sentence(
        "IV-B 1, V",
        '"some runs near 0.7", by one reading of the radius',
        "best tower's RMSE / 0.7, by R, by rho, by rho + R",
        _least,
    ),
    Sentence(
        "IV-B 1",
        'robots at greater heights have "lower error variation"',
        "sd by thirds from the ground up",
        _varies_less,
    ),
    Sentence(
        "IV-B 1",
        '"the cross-section narrows with height"',
        "towers whose thirds hold ever fewer robots",
        _narrows,
    ),
    Sentence(
        "IV-B 1, Fig.",
        'towers: "joining order does not correlate" with the error',
        "rank correlation",
        _follows_order("tower", expected=False),
    ),
    Sentence(
        "IV-B 2",
        "towers, no Z: RMSE grows (paper + 12 %)",
        "change",
        _grows("tower", NO_Z, ALL, RMSE),
    ),
    Sentence(
        "IV-B 2",
        'towers, no Z: d grows (paper + 13 %), "a genuine distortion"',
        "change",
        _grows("tower", NO_Z, ALL, DISPARITY),
    ),
    Sentence(
        "IV-B 2",
        'towers, no Z: d grows "proportionally" to RMSE',
        "change of RMSE, of d",
        _proportional("tower", NO_Z, ALL),
    ),
    Sentence(
        "IV-B 3",
        'towers, neither: "the largest error among conditions"',
        "RMSE of all cues, no Z, neither",
        _largest,
    ),
    Sentence(
        "IV-B 3",
        'towers, neither: d grows "proportional" to RMSE (paper: RMSE + 44, d + 47 %)',
        "change of RMSE, of d",
        _proportional("tower", NEITHER, ALL),
    ),
    Sentence(
        "IV-B 3",
        'towers: repulsion is "more critical for maintaining structural fidelity" than Z',
        "change of d without Z, then without repulsion",
        _more_critical,
    ),
    Sentence(
        "IV-B 3",
        'towers: without repulsion, "unconnected docks collapse inward"',
        "overlapping pairs a robot, no Z, neither",
        _collapses,
    ),
    Sentence(
        "V",
        'towers: repulsion "reduces both RMSE and shape disparity"',
        "change of RMSE, of d, without it",
        _grows("tower", NEITHER, NO_Z, RMSE, DISPARITY),
    ),
    Sentence(
        "IV-C 1",
        "cantilevers err more than towers",
        "RMSE of towers, of cantilevers",
        _harder_cantilevers,
    ),
    Sentence(
        "III-C 2, IV-C 2",
        'Z is "especially effective" in towers, "weaker" in cantilevers',
        "change of RMSE without it, towers, cantilevers",
        _weaker_in_cantilevers,
    ),
    Sentence(
        "IV-C 1",
        'towers: robots up to the 10th are "among the lowest-error points"',
        "mean error, theirs and of the others",
        _early_are_best("tower", expected=True),
    ),
    Sentence(
        "IV-C 1",
        "cantilevers: these robots are not",
        "mean error, theirs and of the others",
        _early_are_best("cantilever", expected=False),
    ),
    Sentence(
        "IV-C 1, V",
        'cantilevers: "error accumulates" (IV-C 1: of robots 2 to 12; here of all)',
        "rank correlation with contacts from the anchor",
        _accumulates("cantilever", expected=True),
    ),
    Sentence(
        "IV-C 2",
        "cantilevers, no Z: RMSE grows (paper + 35 %)",
        "change",
        _grows("cantilever", NO_Z, ALL, RMSE),
    ),
    Sentence(
        "IV-C 2",
        'cantilevers, no Z: d grows (paper + 32 %), no "simple global offset"',
        "change",
        _grows("cantilever", NO_Z, ALL, DISPARITY),
    ),
    Sentence(
        "IV-C 2",
        'cantilevers, no Z: d grows "proportional" to RMSE',
        "change of RMSE, of d",
        _proportional("cantilever", NO_Z, ALL),
    ),
    Sentence(
        "IV-C 2",
        'cantilevers, no Z: a "wider shaded band"',
        "sd over structures, all cues, no Z",
        _wider,
    ),
    Sentence(
        "IV-C 3, V",
        'cantilevers: repulsion has "little impact on RMSE"',
        "change without it",
        _hardly_changes,
    ),
    Sentence(
        "IV-C 3",
        'cantilevers, no Z and neither: the bands "largely overlap"',
        "share of the narrower band",
        _bands_overlap,
    ),
    Sentence(
        "IV-C 3, V",
        "cantilevers: d grows without repulsion (paper + 14 %)",
        "change",
        _grows("cantilever", NEITHER, NO_Z, DISPARITY),
    ),
    Sentence(
        "IV-C 3, V",
        "near docks that do not touch are rarer in cantilevers",
        "pairs a robot, towers, cantilevers",
        _rarer,
    ),
    Sentence(
        "Table II",
        "cantilevers, neither: RMSE and d grow (paper + 31, + 51 %)",
        "change of RMSE, of d",
        _grows("cantilever", NEITHER, ALL, RMSE, DISPARITY),
    ),
    Sentence(
        "V",
        '"in both cases" errors are "on the order of one dock diameter"',
        "RMSE of towers, of cantilevers [diameters]",
        _near_one_diameter,
    ),
    Sentence(
        "V",
        'errors depend on "join order"',
        "rank correlation with the join order, towers, cantilevers",
        _follows_order(*BOTH, expected=True),
    ),
    Sentence(
        "V",
        'towers: errors "do not accumulate"',
        "rank correlation with contacts from the anchor",
        _accumulates("tower", expected=False),
    ),
)


def sentence_table(sets: Mapping[str, Facts]) -> str:
    """Write a row for each sentence: the verdicts by both starts without Z, and the numbers."""
    rows = []
    for sentence in SENTENCES:
        upward, own_axis = _findings(sentence, sets)
        verdicts = [verdict([finding.holds for finding in upward])]
        rests_on_start = upward != own_axis
        verdicts.append(verdict([f.holds for f in own_axis]) if rests_on_start else "")
        row = [sentence.section, sentence.says, *verdicts, sentence.number]
        rows.append([*row, *(finding.number for finding in upward)])
    return table(["section", "the paper", "here", "own axis", "number", *sets], rows)


def _findings(sentence: Sentence, sets: Mapping[str, Facts]) -> tuple[list[Finding], list[Finding]]:
    """Judge a sentence by each set: robots without Z start upward, or along their own axis."""
    return (
        [sentence.judge(facts) for facts in sets.values()],
        [sentence.judge(replace(facts, own_axis=True)) for facts in sets.values()],
    )


def reproduces(ratio: float) -> bool:
    """Whether a number of ours is within `WITHIN` of the paper's."""
    return abs(ratio - 1.0) <= WITHIN


def verdict(holds: Sequence[bool]) -> str:
    """Say whether a sentence holds in all sets, in some, or in none."""
    if all(holds):
        return "holds"
    return "depends" if any(holds) else "does not hold"


def sentence_verdicts(sets: Mapping[str, Facts], *, own_axis: bool) -> list[str]:
    """Judge all sentences, for one start of robots without Z."""
    findings = [_findings(sentence, sets)[own_axis] for sentence in SENTENCES]
    return [verdict([finding.holds for finding in row]) for row in findings]
