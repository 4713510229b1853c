"""Counts what makes the package easy or hard to carry on, in the working tree or at a commit.

    python -m benchmarks.house
    python -m benchmarks.house --against 6f1f2ba     # two columns: then and now
    python -m benchmarks.house --at 6f1f2ba

The table is Markdown. A commit is read from `git archive`; nothing is checked out. Where each
concept is written stands in `places.csv`.
"""

import argparse
import ast
import csv
import re
import subprocess
import tarfile
import tempfile
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from io import BytesIO, StringIO
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]

FIRST = "6f1f2ba"
"""The commit whose places a reader counted."""

KEYS = ("ranges", "touches", "fixes", "displacements", "flip_height", "directions")
"""Keys of a log that are searched as words."""

PARTS = {
    "online": ("localization.online", "parts.online"),
    "between": ("localization.distributed", "parts.between"),
    "peers": ("localization.hop_by_hop", "localization.least_squares", "parts.peers"),
    "suites": ("sensing.suites", "parts.suites"),
    "formats": ("interop", "parts.formats"),
    "advice": ("measurements.advice", "measurements.placement", "parts.advice"),
    "pictures": ("report.render", "parts.pictures"),
    "live": ("app.live", "parts.live"),
    "navigation": ("study.navigation", "parts.navigation"),
}
"""By optional part, its modules then and now."""

METHODS = {
    "joint": ("localization.joint",),
    "virtual-force": ("localization.virtual_force", "localization.together"),
    "online": PARTS["online"],
    "distributed": PARTS["between"],
    "hop-by-hop": ("localization.hop_by_hop",),
    "least-squares": ("localization.least_squares",),
    "peers": ("parts.peers",),
}
"""By method, the modules that only it is made of; methods of one part are one."""

ROOTS = {
    "joint": ("localization.joint", "localization.joint.method"),
    "Tracker": ("parts.online.tracker", "localization.online.tracker"),
    "distributed": ("parts.between.method", "localization.distributed.method"),
}
"""By what is loaded, the modules that load it; the closure of the largest counts."""

NUMERICAL = ("compute", "engine", "localization", "measurements", "world", "parts.online",
             "parts.between", "parts.peers")  # fmt: skip
"""Rooms of numerical code."""

with Path(__file__).with_name("places.csv").open(encoding="utf-8") as _file:
    CONCEPTS = {row["concept"]: row for row in csv.DictReader(_file)}
"""By concept, how many places a reader counted at `FIRST`, and the places of today: a function in
each file that writes the equation or decides."""

NAMED = {
    "names of cues": '"walk_contacts"',
    "names of methods": '"joint"',
    "doors": r"import_module\(module\)|entry_points\(",
}
"""By list, what only files match that write one."""

_DIRECTIVE = re.compile(r"# (noqa|type:|fmt:)")
"""A comment for a tool, not for a reader."""
_LAYOUT = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


class House:
    """The modules of the package at one time."""

    def __init__(self, root: Path) -> None:
        """Read the modules below a folder that holds `tiswarm`."""
        files = sorted((root / "tiswarm").rglob("*.py"))
        self.text = {_name(f.relative_to(root)): f.read_text(encoding="utf-8") for f in files}

    @cached_property
    def tree(self) -> dict[str, ast.Module]:
        """Syntax tree of each module."""
        return {name: ast.parse(text) for name, text in self.text.items()}

    def lines(self, *rooms: str) -> int:
        """Count lines of modules in rooms, of all if none is named."""
        return sum(len(text.splitlines()) for name, text in self.text.items() if _in(name, rooms))

    def import_lines(self) -> int:
        """Count lines of import statements."""
        return sum(
            node.end_lineno - node.lineno + 1
            for tree in self.tree.values()
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom)
        )

    def comments(self) -> float:
        """Count comments for readers per 100 lines of numerical code without docstrings."""
        found = [_comments(self.text[name], self.tree[name])
                 for name in self.text if _in(name, NUMERICAL)]  # fmt: skip
        comments, code = map(sum, zip(*found, strict=True))
        return 100.0 * comments / code

    def with_word(self, pattern: str) -> int:
        """Count modules in whose text a pattern occurs."""
        return sum(bool(re.search(pattern, text)) for text in self.text.values())

    def using(self, key: str) -> int:
        """Count modules with a key as a literal, an attribute, an argument or a field."""
        return sum(any(key in _names(node) for node in ast.walk(tree))
                   for tree in self.tree.values())  # fmt: skip

    @cached_property
    def named(self) -> dict[str, set[str]]:
        """What each module imports, within functions too, and the modules that it names as text."""
        texts = {
            name: {each[0] for each in re.findall(r'"tiswarm\.([\w.]+)(:\w+)?"', text)}
            for name, text in self.text.items()
        }
        return {name: {*self.imports(name, lazy=True), *texts[name]} for name in self.text}

    def naming(self, part: Sequence[str]) -> list[str]:
        """List modules that name a part as text or import it, and are not its own."""
        return [
            name
            for name, named in self.named.items()
            if not _in(name, part) and any(_in(each, part) for each in named)
        ]

    def imports(self, name: str, *, lazy: bool = False) -> Iterator[str]:
        """List what a module imports from the package, within functions too if lazy."""
        tree = self.tree[name]
        for node in ast.walk(tree) if lazy else tree.body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tiswarm"):
                origin = (node.module or "").removeprefix("tiswarm").removeprefix(".")
                yield origin
                yield from (f"{origin}.{each.name}".removeprefix(".") for each in node.names)

    def taken(self) -> set[tuple[str, str]]:
        """Collect the names that a method's modules import from another method's."""
        return {
            (own, each)
            for name, named in self.named.items()
            for each in named
            if (own := _method_of(name)) and each not in self.text
            if (other := _method_of(each)) and other != own
        }

    def closure(self, roots: Sequence[str]) -> int:
        """Count lines of all modules that the import of one of the roots loads; the largest."""
        return max(self._closure(root) for root in roots)

    def _closure(self, root: str) -> int:
        loaded, waiting = set[str](), [root]
        while waiting:
            name = waiting.pop()
            if name in self.text and name not in loaded:
                loaded.add(name)
                waiting += self.imports(name)
        return sum(len(self.text[name].splitlines()) for name in loaded)

    def has(self, place: str) -> bool:
        """Whether a place, file:function, exists."""
        file, _, function = place.partition(":")
        tree = self.tree.get(file.replace("/", "."))
        kinds = ast.FunctionDef | ast.ClassDef
        return tree is not None and any(
            isinstance(node, kinds) and node.name == function for node in ast.walk(tree)
        )


def _name(file: Path) -> str:
    """Name a module without the package: `localization.joint`."""
    parts = file.with_suffix("").parts[1:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _in(name: str, rooms: Sequence[str]) -> bool:
    return not rooms or f"{name}.".startswith(tuple(f"{room}." for room in rooms))


def _names(node: ast.AST) -> Iterator[object]:
    """Yield what a syntax node names: a literal, an attribute, an argument or a field."""
    if isinstance(node, ast.Constant):
        yield node.value
    elif isinstance(node, ast.Attribute):
        yield node.attr
    elif isinstance(node, ast.keyword):
        yield node.arg
    elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        yield node.target.id


def _method_of(name: str) -> str:
    return next((method for method, rooms in METHODS.items() if _in(name, rooms)), "")


def _comments(text: str, tree: ast.Module) -> tuple[int, int]:
    """Count a module's comments for readers, and its lines of code."""
    documented = {
        line
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, node.end_lineno + 1)
    }  # fmt: skip
    comments, lines = 0, set[int]()
    for token in tokenize.generate_tokens(StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments += not _DIRECTIVE.match(token.string)
        elif token.type not in _LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return comments, len(lines - documented)


def places(house: House, commit: str) -> dict[str, int]:
    """Count places by concept: those of the reader, else those of the table that exist."""
    counted = {
        concept: int(row[f"at {FIRST}"]) if commit == FIRST else sum(map(house.has, places_of(row)))
        for concept, row in CONCEPTS.items()
    }
    return counted | {name: house.with_word(pattern) for name, pattern in NAMED.items()}


def places_of(row: Mapping[str, str]) -> list[str]:
    """List the places of a concept, file:function."""
    return row["today"].split()


def counts(house: House, commit: str = "") -> dict[str, str]:
    """Count everything, by what is counted."""
    lines, parts = house.lines(), house.lines("parts")
    imports = 100.0 * house.import_lines() / lines
    naming = {name: {*house.naming(modules)} for name, modules in PARTS.items()}
    every = set[str]().union(*naming.values())
    optional = [module for modules in PARTS.values() for module in modules]
    written = places(house, commit)
    numbers = {
        "files": len(house.text),
        "lines": lines,
        "lines of the core": lines - parts,
        "lines of parts": parts,
        **{f"files with the word `{key}`": house.with_word(rf"\b{key}\b") for key in KEYS},
        **{f"files that use the key `{key}`": house.using(key) for key in KEYS},
        "files with `rmse_R`": house.with_word("rmse_R"),
        **{f"files that name the part {name}": len(files) for name, files in naming.items()},
        "files that name a part": len(every),
        "files of the core that name a part": sum(not _in(name, optional) for name in every),
        "names that methods take from each other": len(house.taken()),
        **{f"lines that {name} loads": house.closure(roots) for name, roots in ROOTS.items()},
        **{f"places: {name}": number for name, number in written.items()},
        "places of all concepts": sum(written.values()),
    }
    shares = {
        "imports, of all lines": f"{imports:.1f} %",
        "comments per 100 lines of numerical code": f"{house.comments():.1f}",
    }
    return {name: f"{number:,}" for name, number in numbers.items()} | shares


def count_at(commit: str) -> dict[str, str]:
    """Count a commit, or the working tree if it is empty."""
    if not commit:
        return counts(House(REPOSITORY))
    packed = subprocess.run(  # noqa: S603 - a commit of this repository
        ["git", "archive", commit, "tiswarm"],  # noqa: S607
        cwd=REPOSITORY,
        capture_output=True,
        check=True,
    ).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=BytesIO(packed)) as files:
        files.extractall(folder, filter="data")
        return counts(House(Path(folder)), commit)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--at", default="", metavar="COMMIT", help="what to count")
    parser.add_argument("--against", metavar="COMMIT", help="a first column beside it")
    asked = parser.parse_args()
    commits = [each for each in (asked.against, asked.at) if each is not None]
    columns = {each or "now": count_at(each) for each in commits}
    print(f"| | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}")
    for name in dict.fromkeys(name for column in columns.values() for name in column):
        print(f"| {name} | {' | '.join(column.get(name, '') for column in columns.values())} |")


if __name__ == "__main__":
    main()
