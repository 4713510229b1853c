"""Files and functions that docs/tour.md names exist."""

import re
from itertools import takewhile

from tests.runs import REPOSITORY

TOUR = (REPOSITORY / "docs" / "tour.md").read_text()


def stops() -> list[str]:
    """Files of the numbered list, in reading order."""
    return re.findall(r"^\d+\. `([^`]+)`", TOUR, flags=re.MULTILINE)


def test_stops_of_the_tour_are_distinct():
    """Nobody reads a file twice."""
    files = stops()

    assert len(files) == len(set(files)) > 0


def test_files_and_names_of_the_tour_exist():
    """Files are named in full, or as a neighbor of the stop or as a path in the package."""
    package = REPOSITORY / "tiswarm"
    for paragraph in re.split(r"^(?=\d+\. |\| )", TOUR, flags=re.MULTILINE)[1:]:
        named = re.findall(r"`([\w/]+\.py)`", paragraph)
        for file in named:
            near = (REPOSITORY / named[0]).parent / file
            here = [REPOSITORY / file, package / file, near]
            assert any(path.is_file() for path in here) or [*package.rglob(file)], file


def test_functions_that_the_tour_names_are_in_its_files():
    """A stop that lost them would mislead its reader."""
    source = "".join((REPOSITORY / stop).read_text() for stop in stops())
    for name in ("_CaseRunner", "observe", "localize_many", "measure", "pose_problem", "judge"):
        assert f"`{name}" in TOUR
        assert re.search(rf"\b{name}\b", source), name


def test_the_tour_is_linked_first():
    """README, architecture and CONTRIBUTING send a new reader there before all else."""
    for page in ("docs/architecture.md", "CONTRIBUTING.md"):
        text = (REPOSITORY / page).read_text()
        links = re.findall(r"\]\(([^)]+\.md)[^)]*\)", text)
        assert links[0].endswith("tour.md"), page
    readme = (REPOSITORY / "README.md").read_text()
    developers = [*takewhile(lambda line: "architecture" not in line, readme.splitlines())]
    assert any("docs/tour.md" in line for line in developers)
