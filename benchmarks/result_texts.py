"""Results found by what they are of, and how pages write them."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal

import pandas as pd
from scipy.stats import fisher_exact

from tiswarm.base.errors import InputError

BOTH = ("tower", "cantilever")
"""Kinds of structures, in the order of the tables."""


@dataclass(frozen=True)
class Result:
    """Mean of a measure over structures, in the unit of the file."""

    mean: float
    """Mean."""

    half_width: float
    """Half the width of its 95 % confidence interval; NaN for few structures."""

    structures: int
    """Number of structures."""


class Results:
    """The results of a file, found by what they are of."""

    def __init__(self, table: pd.DataFrame) -> None:
        """Index the rows of `read_results`."""
        self._rows: dict[tuple[str, ...], dict[str, Result]] = {}
        for row in table.itertuples():
            key = (row.scenario, row.condition, row.point, row.measure, row.kind)
            result = Result(row.value, (row.high - row.low) / 2.0, row.structures)
            self._rows.setdefault(key, {})[getattr(row, "seeds", "")] = result

    def of(
        self,
        scenario: str,
        condition: str,
        point: str,
        measure: str,
        kind: str,
        *,
        seeds: str = "",
    ) -> Result:
        """Return the one result of these columns, of any seeds if none are named.

        Raises:
            InputError: the file has no such result, or several of different structures.
        """
        rows = self._rows.get((scenario, condition, point, measure, kind), {})
        results = [result for of, result in rows.items() if seeds in ("", of)]
        if len(results) != 1:
            problem = (
                f"{len(results)} results of {scenario}, {condition}, {point}, {measure}, {kind}"
            )
            raise InputError(f"{problem}; run the scenario, or name another")
        return results[0]

    def kinds(self, scenario: str, condition: str, point: str, measure: str) -> list[str]:
        """List the kinds of processors that computed a result."""
        columns = (scenario, condition, point, measure)
        return [key[-1] for key in self._rows if key[:-1] == columns]


def fixed(number: float, decimals: int) -> str:
    """Write a number with decimals; stored means end in 5 often, so halves are rounded up."""
    step = Decimal(1).scaleb(-decimals)
    return str(Decimal(repr(float(number))).quantize(step, ROUND_HALF_UP))


def interval(result: Result, decimals: int) -> str:
    """Write a mean and half the width of its confidence interval: `0.37 ± 0.08`."""
    return f"{fixed(result.mean, decimals)} ± {fixed(result.half_width, decimals)}"


def three_digits(number: float) -> str:
    """Write a number with three significant digits and at most three decimals: `18.4`."""
    return fixed(number, _decimals(number))


def kilobytes(result: Result) -> str:
    """Write bytes in kB with three significant digits."""
    return three_digits(result.mean / 1e3)


def kilobytes_interval(result: Result) -> str:
    """Write bytes and half the width of their confidence interval in kB: `2.54 ± 0.13`."""
    mean, half_width = result.mean / 1e3, result.half_width / 1e3
    return f"{three_digits(mean)} ± {fixed(half_width, _decimals(mean))}"


def tens(result: Result) -> str:
    """Write a mean to the next ten: `5,830`."""
    return f"{round(result.mean, -1):,.0f}"


def percent(share: float) -> str:
    """Write a share in percent: `54 %`."""
    return f"{fixed(100.0 * share, 0)} %"


def count_of(share: Result) -> int:
    """Return the number of structures that a share stands for."""
    return round(share.mean * share.structures)


def count(share: Result) -> str:
    """Write a share of structures as their number: `28 of 64`."""
    return f"{count_of(share)} of {share.structures}"


def small_p(p: float) -> str:
    """Write a probability with up to two significant digits: `0.014`, `1.7e-10`."""
    return f"{p:.2g}".replace("e-0", "e-")


def p_between(share: Result, reference: Result) -> float:
    """Compute p of Fisher's exact test for two shares of structures."""
    pairs = [[count_of(r), r.structures - count_of(r)] for r in (share, reference)]
    return float(fisher_exact(pairs).pvalue)


def span(numbers: Sequence[float], decimals: int) -> str:
    """Write the least and the greatest of numbers: `1.2 to 1.5`, or one where both round alike."""
    least, greatest = (fixed(end, decimals) for end in (min(numbers), max(numbers)))
    return least if least == greatest else f"{least} to {greatest}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table in Markdown.

    Raises:
        ValueError: a row has more or fewer cells than the header.
    """
    lines = [header, *rows]
    if any(len(cells) != len(header) for cells in lines):
        raise ValueError(f"rows of a table should have {len(header)} cells: {lines}")
    first, *others = (f"| {' | '.join(cells)} |" for cells in lines)
    return "\n".join([first, "|---" * len(header) + "|", *others])


def _decimals(number: float) -> int:
    """Count the decimals by which a number has three significant digits, up to three."""
    return min(3, max(0, 2 - math.floor(math.log10(number))))
