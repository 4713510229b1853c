"""Links and names on the pages of the project lead somewhere."""

import re
from pathlib import Path

import numpy as np
import pytest

import tiswarm
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.store import RunFolder

REPOSITORY = Path(__file__).parents[1]
PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((REPOSITORY / "docs").rglob("*.md")),
]
NAMED = r"\b((?:scenarios|tests|docs)/[\w./-]+\.(?:csv|jsonl|json|md|py|yaml))"
PLUGIN = "of a plug-in that you load"
"""Part of the message on a name that a plug-in would bring."""


def _name(page: Path) -> str:
    return str(page.relative_to(REPOSITORY))


def test_links_lead_to_files():
    """A reader who follows a link or opens a named file finds it."""
    missing = []
    for page in PAGES:
        text = page.read_text()
        links = re.findall(r"\]\((?!https?:)([^)#]+)", text)
        paths = [page.parent / link for link in links]
        paths += [REPOSITORY / name for name in re.findall(NAMED, text)]
        missing += [f"{_name(page)}: {path}" for path in paths if not path.exists()]

    assert missing == []


def test_files_that_the_tour_names_exist():
    """A stop names its file in full, and others as neighbors of it or as paths in the package."""
    package = REPOSITORY / "tiswarm"
    tour = (REPOSITORY / "docs" / "tour.md").read_text()
    missing = []
    for paragraph in re.split(r"^(?=\d+\. |\| )", tour, flags=re.MULTILINE)[1:]:
        named = re.findall(r"`([\w/]+\.py)`", paragraph)
        for file in named:
            places = (REPOSITORY, package, (REPOSITORY / named[0]).parent)
            is_file = any((place / file).is_file() for place in places)
            missing += [] if is_file or any(package.rglob(file)) else [file]

    assert missing == []


def test_scenarios_on_pages_have_no_mistakes(tmp_path):
    """A reader can copy them; some need a plug-in of the same page."""
    path = tmp_path / "scenario.yaml"
    mistakes = []
    for page in PAGES:
        for block in re.findall(r"```yaml\n(name:.*?)```", page.read_text(), re.DOTALL):
            path.write_text(block)
            refused = map(str, tiswarm.check(path).mistakes)
            mistakes += [f"{_name(page)}: {line}" for line in refused if PLUGIN not in line]

    assert mistakes == []


def test_the_readme_names_the_folder_of_the_first_run():
    """A reader compares what the first command prints; the name changes with the scenario."""
    scenario = load_scenario(REPOSITORY / "scenarios" / "tower.yaml")

    folder = RunFolder.of(scenario, Path("reports")).path

    assert f"open {folder}/report.html" in (REPOSITORY / "README.md").read_text()


def test_the_list_of_pages_is_complete():
    """The README names a few pages; the list at the end of the site's front has all but notes."""
    docs = REPOSITORY / "docs"
    listed = set(re.findall(r"\]\(([\w/-]+\.md)\)", (docs / "index.md").read_text()))

    pages = {
        str(page.relative_to(docs)) for page in docs.rglob("*.md") if "notes/" not in str(page)
    }
    assert pages - listed == {"index.md", "joss/paper.md"}


def test_the_paper_cites_what_it_lists():
    """The draft for a journal has an entry for each citation, and no other entry."""
    draft = REPOSITORY / "docs" / "joss"
    text = (draft / "paper.md").read_text().partition("bibliography:")[2]
    cited = set(re.findall(r"@(\w+)", text))

    assert cited == set(
        re.findall(r"^@\w+\{(\w+),", (draft / "paper.bib").read_text(), re.MULTILINE)
    )


def test_rows_of_tables_have_the_cells_of_their_header():
    """A lost bar shifts all numbers of its row to a wrong column."""
    ragged = []
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
        for table in re.findall(r"(?:^ *\|.*\n?)+", text, re.MULTILINE):
            counts = {row.count("|") - row.count("\\|") for row in table.splitlines()}
            ragged += [f"{_name(page)}: {table}"] if len(counts) > 1 else []

    assert ragged == []


def test_the_example_log_can_be_localized(tmp_path):
    """A reader can copy it as a start for a log of their own."""
    text = (REPOSITORY / "docs" / "files.md").read_text()
    example = re.search(r"```json\n(.*?)```", text, re.DOTALL)
    log = tmp_path / "sensing.jsonl"
    log.write_text(example[1])

    estimate = tiswarm.localize(log, "joint")

    # Both robots lie on the ground, and their docks 0 touch: center, dock, dock, center.
    distance = np.linalg.norm(estimate.position[1] - estimate.position[0])
    assert distance < 1.506 + 2.0 + 1.506 + 0.05  # 5 sd of a contact and of a height
    assert estimate.position[1, 2] == pytest.approx(1.0, abs=0.05)
