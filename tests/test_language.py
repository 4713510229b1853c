"""Pages, help texts, messages and docstrings avoid words that readers stumble over."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
BANNED = re.compile(
    r"\b(told|tells?|felt|amid|lest|whoever|whatever|likewise|of which|be it)\b"
    r"|[,;] for (?:it|they|there|he|she|we|these|those) "
    r"|\bso (?!that\b)\w+ that\b",
    re.IGNORECASE,
)
"""Everyday words in place of terms, `for` in place of because, and chains with `so ... that`."""

PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((REPOSITORY / "docs").rglob("*.md")),
    *sorted((REPOSITORY / "scenarios").glob("*.yaml")),
    *sorted((REPOSITORY / "tiswarm" / "report" / "templates").iterdir()),
]
MODULES = sorted(
    path for part in ("tiswarm", "benchmarks") for path in (REPOSITORY / part).rglob("*.py")
)


def texts_of(module: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each string in a module: docstrings, messages and help."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def found_in(texts: Iterator[tuple[int, str]]) -> list[str]:
    """List banned words with their line."""
    return [f"{line}: {match[0]}" for line, text in texts for match in BANNED.finditer(text)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_pages_use_plain_words(page):
    """Pages, scenarios and the templates of a run's page avoid the words."""
    assert found_in(enumerate(page.read_text().splitlines(), start=1)) == []


@pytest.mark.parametrize(
    "module",
    MODULES,
    ids=lambda module: str(module.relative_to(REPOSITORY)),
)
def test_modules_use_plain_words(module):
    """Docstrings, messages and help texts of the package and of benchmarks avoid the words."""
    assert found_in(texts_of(module)) == []


@pytest.mark.parametrize(
    "text", ["It tells all.", "This holds, for it is small.", "so far that robots leave"]
)
def test_banned_words_are_found(text):
    """The pattern knows words, `for` and chains."""
    assert BANNED.search(text)


@pytest.mark.parametrize("text", ["so that", "a table, for each robot", "stellar", "foretold"])
def test_other_words_are_not(text):
    """Parts of words and other uses are allowed."""
    assert not BANNED.search(text)
