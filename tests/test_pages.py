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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_links_lead_to_files(page):
    """A reader who follows a link or opens a named file finds it."""
    text = page.read_text()
    links = re.findall(r"\]\((?!https?:)([^)#]+)", text)

    missing = [link for link in links if not (page.parent / link).exists()]
    missing += [name for name in re.findall(NAMED, text) if not (REPOSITORY / name).exists()]

    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_scenarios_on_pages_have_no_mistakes(page, tmp_path):
    """A reader can copy them; some need a plug-in of the same page."""
    mistakes = []
    for block in re.findall(r"```yaml\n(name:.*?)```", page.read_text(), re.DOTALL):
        (tmp_path / "scenario.yaml").write_text(block)
        found = tiswarm.check(tmp_path / "scenario.yaml").mistakes
        mistakes += [str(each) for each in found if "of a plug-in that you load" not in str(each)]

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
    assert pages - listed == {"index.md"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_rows_of_tables_have_the_cells_of_their_header(page):
    """A lost bar shifts all numbers of its row to a wrong column."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    ragged = []
    for table in re.findall(r"(?:^ *\|.*\n?)+", text, re.MULTILINE):
        counts = {row.count("|") - row.count("\\|") for row in table.splitlines()}
        ragged += [table] if len(counts) > 1 else []

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
