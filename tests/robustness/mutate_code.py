"""A trial of the tests: change one expression of numerical code, and see whether a test fails.

    python -m tests.robustness.mutate_code --count 300 --seed 0

A mutant is a copy of the code with one small mistake: another sign, operator, constant, comparison,
function or index. First all tests of the numerical rooms run once, which notes how long each takes
and what lines it executes. Then each mutant is given the tests that
execute its line, the quickest first, until one fails. The table `mutants.csv` has a row for each:
number, file, line, the line before and after, outcome, and the test that noticed it. What no test
notices is equal in effect, only slower, or a hole of the tests: a person has to look.

The mistakes are in functions. Constants of modules and defaults of parameters are choices, of which
others would be as right; texts of errors and annotations compute nothing.
"""

import argparse
import ast
import csv
import json
import os
import random
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from coverage import Coverage, CoverageData

REPOSITORY = Path(__file__).parents[2]
LEFT_OUT = (".*", "reports", "build")
"""What a copy of the repository does not need."""

ROOMS = {
    "tiswarm/compute": ["test_math.py", "test_cell_list.py", "test_neighbor_list.py"],
    "tiswarm/engine": [""],
    "tiswarm/world": [""],
    "tiswarm/measurements": [""],
    "tiswarm/localization": [""],
    "tiswarm/evaluation": [""],
}
"""Files of tests by room, in its folder of tests; all of them where none is named."""

NOT_NUMERICAL = {
    "__init__.py", "backend.py", "kernel_cache.py", "lang.py", "machine.py", "paper.py",
    "methods.py", "params.py", "settings.py",
}  # fmt: skip
"""Files that start something, or hold choices."""

SLOWEST_S, TESTS_S, LIMIT_S = 8.0, 40.0, 240.0
"""Time of the slowest test that a mutant is given, of all its tests, both without it, and after
which it counts as noticed [s]."""

OPERATORS: dict[type[ast.AST], tuple[str, tuple[str, ...]]] = {
    ast.Add: ("+", ("-",)),
    ast.Sub: ("-", ("+",)),
    ast.Mult: ("*", ("/",)),
    ast.Div: ("/", ("*",)),
    ast.FloorDiv: ("//", ("*",)),
    ast.Pow: ("**", ("*",)),
    ast.BitAnd: ("&", ("|",)),
    ast.BitOr: ("|", ("&",)),
    ast.LShift: ("<<", (">>",)),
    ast.RShift: (">>", ("<<",)),
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.And: ("and", ("or",)),
    ast.Or: ("or", ("and",)),
}


def _both_ways(*pairs: tuple[str, str]) -> dict[str, str]:
    return dict(pairs) | {b: a for a, b in pairs}


FUNCTIONS = _both_ways(
    ("max", "min"), ("maximum", "minimum"), ("sin", "cos"), ("any", "all"), ("argmax", "argmin"),
    ("floor", "ceil"), ("zeros", "ones"),
)  # fmt: skip
ARRAYS = _both_ways(("robot", "neighbor"), ("arm", "neighbor_arm"), ("fmax", "fmin"))
"""Names that are mistaken for each other: of functions, and of attributes."""


class Site(NamedTuple):
    """Bytes of a file that can be mistaken."""

    file: str
    start: int
    end: int
    mistakes: tuple[str, ...]
    """What could stand there."""


class Mutant(NamedTuple):
    """A file with one mistake."""

    file: str
    line: int
    before: str
    """The line without the mistake."""

    after: str
    source: bytes


# --- mistakes --------------------------------------------------------------------------------


def sites(root: Path) -> list[Site]:
    """List what can be mistaken in the numerical rooms of a copy of the code."""
    files = [file for room in ROOMS for file in sorted((root / room).rglob("*.py"))]
    return [
        Site(str(file.relative_to(root)), *span)
        for file in files
        if file.name not in NOT_NUMERICAL
        for span in _spans(file.read_bytes())
    ]


def mutant(root: Path, site: Site, random: random.Random) -> Mutant:
    """Make one mistake."""
    source = (root / site.file).read_bytes()
    changed = source[: site.start] + random.choice(site.mistakes).encode() + source[site.end :]
    row = source[: site.start].count(b"\n")
    before, after = (text.splitlines()[row].decode().strip() for text in (source, changed))
    return Mutant(site.file, row + 1, before, after, changed)


def _spans(source: bytes) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """Yield the start and end of what can be mistaken, and the mistakes."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in _computed(ast.parse(source)):
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        yield from ((start, start + size, others) for size, others in _signs(node))
        yield from ((end - size, end, others) for size, others in _words(node))
        for left, operator in _operators(node):
            sign, others = OPERATORS[type(operator)]
            at = starts[(left.end_lineno or 0) - 1] + (left.end_col_offset or 0)
            at = source.index(sign.encode(), at)
            yield at, at + len(sign), others


def _signs(node: ast.expr) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield the length of a sign before an operand, which can be left out."""
    match node:
        case ast.UnaryOp(ast.Not()):
            yield len("not"), ("",)
        case ast.UnaryOp(ast.USub()):
            yield len("-"), ("",)


def _words(node: ast.expr) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield the length of a number or of the last name of an expression, and others."""
    match node:
        case ast.Constant(bool()):
            pass
        case ast.Constant(float(value)):
            others = repr(1.1 * value or 1.0), f"(-{value or 1.0!r})"
            yield (node.end_col_offset or 0) - node.col_offset, others
        case ast.Constant(int(value)):
            others = str(value + 1), str(abs(value - 1))
            yield (node.end_col_offset or 0) - node.col_offset, others
        case ast.Name(name) if name in FUNCTIONS:
            yield len(name), (FUNCTIONS[name],)
        case ast.Attribute(_, name) if name in FUNCTIONS | ARRAYS:
            yield len(name), ((FUNCTIONS | ARRAYS)[name],)


def _operators(node: ast.expr) -> Iterator[tuple[ast.expr, ast.AST]]:
    """Yield the left operand of each operator that can be mistaken, and the operator."""
    match node:
        case ast.BinOp(left, operator, _) | ast.Compare(left, [operator], _):
            found: list[tuple[ast.expr, ast.AST]] = [(left, operator)]
        case ast.BoolOp(operator, values):
            found = [(left, operator) for left in values[:-1]]
        case _:
            found = []
    yield from (each for each in found if type(each[1]) in OPERATORS)


def _computed(tree: ast.Module) -> Iterator[ast.expr]:
    """Yield the expressions of functions that compute something."""
    for function in ast.walk(tree):
        waiting: list[ast.AST] = [*function.body] if isinstance(function, ast.FunctionDef) else []
        while waiting:
            node = waiting.pop(0)
            if isinstance(node, ast.Raise | ast.JoinedStr | ast.FunctionDef):
                continue
            if isinstance(node, ast.expr):
                yield node
            ignored = getattr(node, "annotation", None)
            waiting += [each for each in ast.iter_child_nodes(node) if each is not ignored]


# --- what tests do without mistakes ----------------------------------------------------------

_coverage = Coverage(
    data_file=os.environ.get("MUTANTS_RECORD"), config_file=False, include=["*/tiswarm/*"]
)
_seconds: defaultdict[str, float] = defaultdict(float)


def pytest_configure():
    """Note lines from now on, where this module is a plugin of pytest."""
    if "MUTANTS_RECORD" in os.environ:
        _coverage.start()


def pytest_runtest_logstart(nodeid):
    """Note the lines of a test with its fixtures."""
    if "MUTANTS_RECORD" in os.environ:
        _coverage.switch_context(nodeid)


def pytest_runtest_logreport(report):
    """Note the time of a test."""
    _seconds[report.nodeid] += report.duration


def pytest_unconfigure():
    """Write what was noted."""
    if record := os.environ.get("MUTANTS_RECORD"):
        _coverage.stop()
        _coverage.save()
        Path(f"{record}.json").write_text(json.dumps(_seconds), encoding="utf-8")


class Record:
    """What the tests did without a mistake."""

    def __init__(self, root: Path, record: Path) -> None:
        """Read the notes."""
        self.root = root
        self.seconds = json.loads(Path(f"{record}.json").read_text(encoding="utf-8"))
        self.data = CoverageData(str(record))
        self.data.read()

    def tests_of(self, file: str, line: int) -> list[str]:
        """List the tests of a line, the quickest first."""
        found = set(self._contexts(file).get(line, ()))
        if file.endswith("kernels.py"):
            found = self._tests_of_kernels(file)
        chosen, total = [], 0.0
        for test in sorted(found - {""}, key=lambda test: self.seconds[test]):
            total += self.seconds[test]
            if self.seconds[test] < SLOWEST_S and total < TESTS_S:
                chosen.append(test)
        return chosen

    def _contexts(self, file: str) -> dict[int, list[str]]:
        return self.data.contexts_by_lineno(str(self.root / file))

    def _tests_of_kernels(self, file: str) -> set[str]:
        """List tests of what imports a file: kernels are compiled, which no tracer sees."""
        name = file.removesuffix(".py").replace("/", ".")
        package, _, module = name.rpartition(".")
        asked = (f"from {name} import", f"from {package} import {module}")
        found: set[str] = set()
        for path in (self.root / "tiswarm").rglob("*.py"):
            user = str(path.relative_to(self.root))
            text = path.read_text(encoding="utf-8")
            if any(words in text for words in asked):
                if user.endswith("kernels.py"):
                    found |= self._tests_of_kernels(user)
                    continue
                within = {
                    line
                    for function in ast.walk(ast.parse(text))
                    if isinstance(function, ast.FunctionDef)
                    for line in range(function.body[0].lineno, (function.end_lineno or 0) + 1)
                }
                contexts = self._contexts(user)
                found |= {test for line in within for test in contexts.get(line, ())}
        return found


# --- the trial -------------------------------------------------------------------------------


def run_tests(
    root: Path, *arguments: str, limit_s: float | None = None, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run tests in a copy of the code."""
    environment = os.environ | variables | {
        "PYTHONPATH": str(root),
        "XDG_CACHE_HOME": str(root / "cache"),  # kernels with mistakes are of no use later
    }  # fmt: skip
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    return subprocess.run(
        [*command, "--hypothesis-seed=0", *arguments],
        cwd=root, env=environment, timeout=limit_s, capture_output=True, text=True, check=False,
    )  # fmt: skip


def record(root: Path, folder: Path) -> Record:
    """Run all tests of the numerical rooms without a mistake, unless a folder has their record."""
    file = folder / "record"
    if not file.exists():
        tests = [
            str(Path(room.replace("tiswarm", "tests")) / name)
            for room, names in ROOMS.items()
            for name in names
        ]
        done = run_tests(root, "-p", __spec__.name, *tests, MUTANTS_RECORD=str(file))
        if done.returncode:
            raise SystemExit(f"tests fail without a mistake:\n{done.stdout}{done.stderr}")
    return Record(root, file)


def outcome_of(root: Path, mutant: Mutant, tests: list[str]) -> tuple[str, str]:
    """Run tests with a mistake: whether it was noticed, and by what test."""
    file, tests_file = root / mutant.file, root / "chosen.txt"
    right = file.read_bytes()
    tests_file.write_text("\n".join(tests), encoding="utf-8")
    if not tests:
        return "no test", ""
    file.write_bytes(mutant.source)
    try:
        done = run_tests(root, "-x", f"@{tests_file.name}", limit_s=LIMIT_S)
    except subprocess.TimeoutExpired:
        return "timed out", ""
    finally:
        file.write_bytes(right)
    if done.returncode == 0:
        return "survived", f"{len(tests)} tests"
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return "noticed", failed[1] if failed else f"status {done.returncode}"


def main() -> None:
    """Try so many mutants, and append a line for each to a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first to try")
    parser.add_argument("--folder", type=Path, default=Path("reports/mutants"))
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    folder = asked.folder.resolve()
    root = folder / "code"
    if not root.exists():
        shutil.copytree(REPOSITORY, root, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
    recorded = record(root, folder)
    every = sites(root)
    random.Random(asked.seed).shuffle(every)  # noqa: S311 - no secrets
    with (folder / "mutants.csv").open("a", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        for number in range(asked.first, asked.count):
            chance = random.Random(f"{asked.seed} {number}")  # noqa: S311 - no secrets
            each = mutant(root, every[number], chance)
            outcome = outcome_of(root, each, recorded.tests_of(each.file, each.line))
            table.writerow([number, each.file, each.line, each.before, each.after, *outcome])
            file.flush()


if __name__ == "__main__":
    main()
