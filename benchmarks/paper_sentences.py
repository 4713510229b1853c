"""What the paper says in sentences, beside what the three sets of `scenarios/paper.yaml` show.

Every number is a result of `docs/results.csv`, and every verdict follows from the numbers by one
rule, so a fresh run of the scenario rewrites both tables.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from benchmarks.paper_facts import THIRDS
from benchmarks.result_texts import Result, Results, fixed, percent, small_p, table
from tiswarm.base.robot import FIREANT_RHO
from tiswarm.evaluation.paper import PAPER
from tiswarm.evaluation.tables import DOCK_DIAMETER

ALL, NO_Z, NEITHER = "all-cues", "no-z", "no-z-no-undock"
"""Conditions of the paper's table."""

CHANCE = 0.05
"""Level of tests."""

WITHIN = 0.2
"""Largest relative difference at which a number of the paper counts as reproduced."""

LITTLE = 0.05
"""Largest relative change that counts as little."""

_TWELFTH = 12.0
"""Join index of the paper's 13th robot, counted from 0."""


@dataclass(frozen=True)
class Facts:
    """Results of one set of structures."""

    results: Results
    points: dict[str, str]
    """Point of the sweep by kind of structure."""
    processor: str

    def of(self, kind: str, measure: str, condition: str = ALL) -> Result:
        """Return a result of towers or cantilevers."""
        return self.results.of("paper", condition, self.points[kind], measure, self.processor)

    def mean(self, kind: str, measure: str, condition: str = ALL) -> float:
        """Return the mean of a result."""
        return self.of(kind, measure, condition).mean

    def growth(self, kind: str, condition: str, before: str, measure: str = "rmse_R") -> float:
        """Return by how much a mean grows from one condition to another, relative to the first."""
        return self.mean(kind, measure, condition) / self.mean(kind, measure, before) - 1.0

    def p(self, kind: str, condition: str, measure: str = "rmse_R") -> float:
        """Return p of a paired test against the condition before."""
        return self.mean(kind, f"{measure}_p", condition)


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


def _grows(kind: str, condition: str, before: str, measure: str = "rmse_R") -> Judge:
    """Hold if a measure grows by more than chance."""

    def judge(facts: Facts) -> Finding:
        growth, p = (
            facts.growth(kind, condition, before, measure),
            facts.p(kind, condition, measure),
        )
        return Finding(f"{_percents([growth])} (p {small_p(p)})", growth > 0.0 and p < CHANCE)

    return judge


def _hardly_changes(facts: Facts) -> Finding:
    """Hold if errors of cantilevers change by no more than `LITTLE`."""
    growth, p = facts.growth("cantilever", NEITHER, NO_Z), facts.p("cantilever", NEITHER)
    return Finding(f"{100 * growth:+.1f} % (p {small_p(p)})", abs(growth) <= LITTLE)


def _published(kind: str, condition: str) -> Judge:
    """Hold if an RMSE is within `WITHIN` of the paper's in either unit."""
    key = (kind, condition == ALL, condition != NEITHER)

    def judge(facts: Facts) -> Finding:
        rmse = facts.mean(kind, "rmse_R", condition) / PAPER[key].rmse_radii
        ratios = (rmse / FIREANT_RHO, rmse)
        number = " or ".join(fixed(ratio, 2) for ratio in ratios)
        return Finding(number, any(abs(ratio - 1.0) <= WITHIN for ratio in ratios))

    return judge


def _least(facts: Facts) -> Finding:
    least = facts.mean("tower", "rmse_least_R")
    number = f"{fixed(least / FIREANT_RHO, 2)} or {fixed(least, 2)}"
    return Finding(number, least / FIREANT_RHO <= 0.7 * (1.0 + WITHIN))


def _varies_less(facts: Facts) -> Finding:
    spread = [facts.mean("tower", f"error_sd_{third}_R") for third in THIRDS]
    return Finding(", ".join(fixed(sd, 2) for sd in spread) + " R", spread[0] > max(spread[1:]))


def _share(kind: str, measure: str, *, more_than: float) -> Judge:
    """Hold if a share exceeds a bound."""

    def judge(facts: Facts) -> Finding:
        share = facts.mean(kind, measure)
        return Finding(percent(share), share > more_than)

    return judge


def _no_correlation(facts: Facts) -> Finding:
    found = facts.of("tower", "join_correlation")
    number = f"{fixed(found.mean, 2)} ± {fixed(found.half_width, 2)}"
    return Finding(number, abs(found.mean) <= found.half_width)


def _does_not_add_up(facts: Facts) -> Finding:
    found = facts.of("tower", "hops_correlation")
    number = f"{fixed(found.mean, 2)} ± {fixed(found.half_width, 2)}"
    return Finding(number, found.mean <= found.half_width)


def _largest(facts: Facts) -> Finding:
    rmse = [facts.mean("tower", "rmse_R", condition) for condition in (ALL, NO_Z, NEITHER)]
    p = facts.p("tower", NEITHER)
    number = ", ".join(fixed(value, 2) for value in rmse) + f" R (p {small_p(p)})"
    return Finding(number, rmse[2] > max(rmse[:2]) and p < CHANCE)


def _more_critical(facts: Facts) -> Finding:
    growth = (facts.growth("tower", NO_Z, ALL), facts.growth("tower", NEITHER, NO_Z))
    return Finding(_percents(growth), growth[1] > growth[0])


def _weaker_in_cantilevers(facts: Facts) -> Finding:
    growth = [facts.growth(kind, NO_Z, ALL) for kind in ("tower", "cantilever")]
    return Finding(_percents(growth), growth[1] < growth[0])


def _percents(growth: Sequence[float]) -> str:
    rounded = [round(100.0 * value) for value in growth]  # -0.4 is no -0
    return ", ".join(f"{change:+d}" if change else "0" for change in rounded) + " %"


def _both_need_z(facts: Facts) -> Finding:
    p = [facts.p(kind, NO_Z) for kind in ("tower", "cantilever")]
    grows = [facts.growth(kind, NO_Z, ALL) > 0.0 for kind in ("tower", "cantilever")]
    number = "p " + ", ".join(small_p(value) for value in p)
    return Finding(number, all(grows) and max(p) < CHANCE)


def _alike(kind: str, condition: str, before: str) -> Judge:
    """Hold if disparity and RMSE both grow, and neither more than twice as much as the other."""

    def judge(facts: Facts) -> Finding:
        measures = ("rmse_R", "procrustes_disparity")
        growth = [facts.growth(kind, condition, before, measure) for measure in measures]
        least, most = sorted(growth)
        return Finding(_percents(growth), least > 0.0 and most <= 2.0 * least)

    return judge


def _settles(kind: str) -> Judge:
    """Hold if the RMSE is near its last value after a third of the 300 steps."""

    def judge(facts: Facts) -> Finding:
        step, start = facts.mean(kind, "settled_step"), facts.mean(kind, "start_rmse_R")
        last = facts.mean(kind, "rmse_R")
        number = f"{fixed(start, 1)} to {fixed(last, 1)} R, {step:.0f} steps"
        return Finding(number, step <= 100.0 and last < start)  # noqa: PLR2004 - a third

    return judge


def _slower(kind: str) -> Judge:
    """Hold if both ablations take longer to settle."""

    def judge(facts: Facts) -> Finding:
        steps = [facts.mean(kind, "settled_step", condition) for condition in (ALL, NO_Z, NEITHER)]
        return Finding(", ".join(f"{step:.0f}" for step in steps), min(steps[1:]) > steps[0])

    return judge


def _harder_cantilevers(facts: Facts) -> Finding:
    tower, cantilever = (facts.of(kind, "rmse_R") for kind in ("tower", "cantilever"))
    number = f"{fixed(tower.mean, 2)}, {fixed(cantilever.mean, 2)} R"
    apart = cantilever.mean - cantilever.half_width > tower.mean + tower.half_width
    return Finding(number, apart)


def _gap(facts: Facts) -> Finding:
    low, high = (facts.mean("cantilever", f"{end}_quartile") for end in ("first", "third"))
    return Finding(f"{low:.0f} to {high:.0f}", low <= _TWELFTH <= high)


def _pair(kind: str, first: str, second: str, *, first_smaller: bool) -> Judge:
    """Hold if the first of two mean errors is the smaller one, or is not."""

    def judge(facts: Facts) -> Finding:
        values = facts.mean(kind, first), facts.mean(kind, second)
        number = ", ".join(fixed(value, 2) for value in values) + " R"
        return Finding(number, (values[0] < values[1]) == first_smaller)

    return judge


def _wider(facts: Facts) -> Finding:
    sd = [facts.mean("cantilever", "rmse_sd_R", condition) for condition in (ALL, NO_Z)]
    return Finding(", ".join(fixed(value, 2) for value in sd) + " R", sd[1] > sd[0])


def _rarer(facts: Facts) -> Finding:
    near = [facts.mean(kind, "near_docks") for kind in ("tower", "cantilever")]
    return Finding(", ".join(fixed(value, 2) for value in near), near[1] < near[0])


def _within_dock(facts: Facts) -> Finding:
    share = [facts.mean(kind, "within_dock") for kind in ("tower", "cantilever")]
    return Finding(", ".join(percent(value) for value in share), min(share) > 0.5)  # noqa: PLR2004


def _tilted(facts: Facts) -> Finding:
    rmse = facts.mean("tower", "tilted_rmse_R")
    return Finding(f"{fixed(rmse, 1)} R, 0", rmse > DOCK_DIAMETER)


def _whole(facts: Facts) -> Finding:
    share = min(facts.mean(kind, "whole") for kind in ("tower", "cantilever"))
    return Finding(percent(share), share == 1.0)


SENTENCES = (
    Sentence(
        "IV", "25 structures of 100 robots of each kind", "structures with all robots", _whole
    ),
    Sentence(
        "IV-A", "a tower that leans by 10 deg has a large RMSE and a small d", "RMSE, d", _tilted
    ),
    Sentence(
        "IV-B",
        'towers: the initial error is "rapidly minimized"',
        "RMSE, steps to within 10 % of the last",
        _settles("tower"),
    ),
    Sentence("IV-B", "towers: RMSE 1.64", "ratio, radius rho or R", _published("tower", ALL)),
    Sentence("IV-B, V", '"some runs near 0.7"', "best tower, rho or R", _least),
    Sentence(
        "IV-B",
        'robots at greater heights have "lower error variation"',
        "sd by thirds from the ground up",
        _varies_less,
    ),
    Sentence(
        "IV-B",
        '"the cross-section narrows with height"',
        "towers whose thirds hold ever fewer robots",
        _share("tower", "narrows", more_than=0.5),
    ),
    Sentence(
        "IV-B",
        '"joining order does not correlate" with the error',
        "rank correlation",
        _no_correlation,
    ),
    Sentence(
        "IV-B",
        "early robots (index up to 10) of towers are among the best",
        "mean error, theirs and of the others",
        _pair("tower", "early_error_R", "late_error_R", first_smaller=True),
    ),
    Sentence("IV-B 2", "towers, no Z: RMSE + 12 %", "change", _grows("tower", NO_Z, ALL)),
    Sentence(
        "IV-B 2", "towers, no Z: RMSE 1.84", "ratio, radius rho or R", _published("tower", NO_Z)
    ),
    Sentence(
        "IV-B 2",
        'towers, no Z: d + 13 %, "consistent with" RMSE',
        "change of RMSE, of d",
        _alike("tower", NO_Z, ALL),
    ),
    Sentence(
        "IV-B 3",
        'towers: without both cues "the largest error"',
        "RMSE of all cues, no Z, neither",
        _largest,
    ),
    Sentence(
        "IV-B 3",
        "towers, neither: RMSE 2.36",
        "ratio, radius rho or R",
        _published("tower", NEITHER),
    ),
    Sentence(
        "IV-B 3",
        'towers, neither: d + 47 %, "proportional" to + 44 % of RMSE',
        "change of RMSE, of d",
        _alike("tower", NEITHER, ALL),
    ),
    Sentence(
        "IV-B 3",
        "towers: undocked repulsion matters more than Z",
        "change without Z, without repulsion after that",
        _more_critical,
    ),
    Sentence(
        "IV-B, Fig.",
        'towers: ablations "slow convergence"',
        "steps of all cues, no Z, neither",
        _slower("tower"),
    ),
    Sentence(
        "IV-C",
        'a cantilever "projects horizontally"',
        "robots beyond the edge",
        _share("cantilever", "beyond_edge", more_than=0.5),
    ),
    Sentence(
        "IV-C 1",
        "cantilevers err more than towers",
        "RMSE of towers, of cantilevers",
        _harder_cantilevers,
    ),
    Sentence(
        "III-C, IV-C",
        'Z is "especially effective" in towers, "weaker" in cantilevers',
        "change without Z, towers, cantilevers",
        _weaker_in_cantilevers,
    ),
    Sentence(
        "IV-C 1, V",
        'towers: robots 2 and 3 "attach immediately to the anchor"',
        "towers in which both do",
        _share("tower", "both_at_once", more_than=0.5),
    ),
    Sentence(
        "IV-C 1, V",
        'cantilevers: the first on the anchor is "e.g. the 13th", index 12 of ours',
        "quartiles of its index",
        _gap,
    ),
    Sentence(
        "IV-C 1",
        "cantilevers: robots before that one err more",
        "mean error, theirs and of the others",
        _pair("cantilever", "before_anchor_error_R", "from_anchor_error_R", first_smaller=False),
    ),
    Sentence(
        "IV-C 1",
        "cantilevers: early robots are not among the best",
        "mean error, theirs and of the others",
        _pair("cantilever", "early_error_R", "late_error_R", first_smaller=False),
    ),
    Sentence(
        "IV-C 1",
        'cantilevers: "converges quickly"',
        "RMSE, steps to within 10 % of the last",
        _settles("cantilever"),
    ),
    Sentence(
        "IV-C 1", "cantilevers: RMSE 3.91", "ratio, radius rho or R", _published("cantilever", ALL)
    ),
    Sentence("IV-C 2", "cantilevers, no Z: RMSE + 35 %", "change", _grows("cantilever", NO_Z, ALL)),
    Sentence(
        "IV-C 2", "cantilevers, no Z: a wider band", "sd over structures, all cues, no Z", _wider
    ),
    Sentence(
        "IV-C 2",
        'cantilevers, no Z: d + 32 %, "proportional" to RMSE',
        "change of RMSE, of d",
        _alike("cantilever", NO_Z, ALL),
    ),
    Sentence(
        "IV-C 3",
        'cantilevers: undocked repulsion has "little impact on RMSE"',
        "change without it after Z",
        _hardly_changes,
    ),
    Sentence(
        "IV-C 3",
        "cantilevers: d + 14 % without it",
        "change",
        _grows("cantilever", NEITHER, NO_Z, "procrustes_disparity"),
    ),
    Sentence(
        "IV-C 3, V",
        "near docks that do not touch are rarer in cantilevers",
        "pairs a robot, towers, cantilevers",
        _rarer,
    ),
    Sentence(
        "V",
        'errors are "on the order of one dock diameter", 2 R',
        "robots within 2 R, towers, cantilevers",
        _within_dock,
    ),
    Sentence(
        "V",
        'towers: errors "do not accumulate"',
        "rank correlation with contacts from the anchor",
        _does_not_add_up,
    ),
    Sentence(
        "V", "Z is robust, and should be on for both kinds", "towers, cantilevers", _both_need_z
    ),
)


def sentence_table(sets: dict[str, Facts]) -> str:
    """Write a row for each sentence, with the number of each set and what they say together."""
    rows = []
    for sentence in SENTENCES:
        findings = [sentence.judge(facts) for facts in sets.values()]
        row = [sentence.section, sentence.says, verdict(findings), sentence.number]
        rows.append([*row, *(finding.number for finding in findings)])
    return table(["section", "the paper", "here", "number", *sets], rows)


def verdict(findings: Sequence[Finding]) -> str:
    """Say whether a sentence holds in all sets, in none, or in some."""
    number = sum(finding.holds for finding in findings)
    if number == len(findings):
        return "holds"
    return "depends" if number else "**does not hold**"


def verdict_counts(sets: dict[str, Facts]) -> str:
    """Count the sentences by verdict: `20 hold, 9 do not, 6 depend on the set`."""
    verdicts = [verdict([s.judge(facts) for facts in sets.values()]) for s in SENTENCES]
    holds, depends = verdicts.count("holds"), verdicts.count("depends")
    none = len(verdicts) - holds - depends
    return f"{holds} hold, {none} do not, {depends} depend on the set"
