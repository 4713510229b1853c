"""The site can be built, has every call, and its notebooks and Python examples run."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
from PIL import Image

import tiswarm
from tiswarm.cli import app

REPOSITORY = Path(__file__).parents[1]
DOCS = REPOSITORY / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.md"))
PAGES = [REPOSITORY / "README.md", *sorted(DOCS.rglob("*.md"))]
RUNNING = [
    *NOTEBOOKS, REPOSITORY / "README.md", DOCS / "start.md", DOCS / "guides" / "engine.md",
]  # fmt: skip
"""Pages with cells that run as they stand."""

SHELL = re.compile(r"^ *```sh\n(.*?)^ *```|^((?: {4}.*\n)+)", re.MULTILINE | re.DOTALL)
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def commands_of(page: Path) -> list[list[str]]:
    """List the words of each command of tiswarm in the shell examples of a page."""
    shown = "".join(a or b for a, b in SHELL.findall(page.read_text())).replace("\\\n", "")
    lines = re.findall(r"^ *tiswarm (.*)$", shown, re.MULTILINE)
    return [shlex.split(line.partition(" > ")[0], comments=True) for line in lines]


@pytest.mark.trial
def test_the_site_can_be_built(tmp_path):
    """Sphinx has no warning: links lead to pages and headings, and the menu has all pages."""
    pytest.importorskip("sphinx", reason="the extra docs needs Python 3.11")

    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going"]
    done = subprocess.run(
        [*command, str(DOCS), str(tmp_path / "site")], capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stderr
    assert "engine on" in (tmp_path / "site/index.html").read_text()
    front = (tmp_path / "site/index.html").read_text()
    assert front.index("growing.webp") < front.index('id="start"')
    assert 'id="view"' in (tmp_path / "site/example.html").read_text()
    assert 'src="example.html"' in (tmp_path / "site/index.html").read_text()
    assert 'id="tiswarm.localize"' in (tmp_path / "site/api.html").read_text()
    grow, study = ((tmp_path / f"site/notebooks/{n}.html").read_text() for n in ("grow", "study"))
    assert "<iframe srcdoc=" in grow  # the page of a log, within the page
    assert "data:image/png;base64" in study
    assert "<td>no-heights</td>" in study
    for page in NOTEBOOKS:
        notebook = json.loads((tmp_path / f"site/notebooks/{page.stem}.ipynb").read_text())
        cells = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
        assert cells == [cell.strip() for cell in PYTHON.findall(page.read_text())]
        shown = (tmp_path / f"site/notebooks/{page.stem}.html").read_text()
        assert f'href="{page.stem}.ipynb"' in shown


def test_pictures_fit_a_dark_page():
    """Films and solids are transparent around them; of the others, charts, the site turns all."""
    turned = set(re.findall(r'src\*="([\w-]+)"', (DOCS / "static" / "site.css").read_text()))

    for path in sorted((DOCS / "images").iterdir()):
        with Image.open(path) as picture:
            is_clear = picture.convert("RGBA").getchannel("A").getextrema()[0] == 0
        assert is_clear != any(part in path.stem for part in turned), path.name


def test_every_call_is_on_its_page():
    """A call that `import tiswarm` offers is in the reference."""
    listed = set(re.findall(r":: tiswarm\.(\w+)$", (DOCS / "api.md").read_text(), re.MULTILINE))

    assert listed == set(tiswarm.__all__) - {"__version__"}


@pytest.mark.parametrize("page", RUNNING, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_python_examples_run(page, tmp_path, monkeypatch):
    """The cells of a page run from top to bottom in a copy of the repository's root.

    Of README's large swarm 60 robots do: 10,000 take minutes.
    """
    (tmp_path / "scenarios").symlink_to(REPOSITORY / "scenarios")
    monkeypatch.chdir(tmp_path)
    text = page.read_text().replace("robots=10_000", "robots=60")
    cells = list(PYTHON.finditer(text))

    names: dict[str, object] = {}
    for cell in cells:
        above = text.count("\n", 0, cell.start(1))  # kernels and errors find lines of the page
        code = compile("\n" * above + cell[1], str(page), "exec")
        exec(code, names)  # noqa: S102 - pages of this repository

    assert cells


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_commands_on_pages_exist(page):
    """Each command of a page has the options that the page gives it."""
    group = typer.main.get_command(app)

    for name, *arguments in commands_of(page):
        group.commands[name].make_context(name, arguments)


def test_the_guide_to_own_robots_works(tmp_path, monkeypatch, capsys):
    """Its commands lead from poses to an estimate with its page, and to its errors."""
    (tmp_path / "scenarios").symlink_to(REPOSITORY / "scenarios")
    monkeypatch.chdir(tmp_path)

    for command in commands_of(DOCS / "guides" / "own-robots.md"):
        assert not app(command, standalone_mode=False), capsys.readouterr().err

    assert (tmp_path / "imported" / "view.html").exists()
    assert "RMSE" in capsys.readouterr().out
