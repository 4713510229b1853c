"""Settings of the site, which `make docs` builds from these pages."""

import ast
import base64
import contextlib
import html
import io
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import jupytext
from sphinx.application import Sphinx

import tiswarm

ROOT = Path(__file__).parents[1]
IN_ROOT = {"index": "README.md"}
"""Pages of the site whose text stands in the root of the repository."""

EXAMPLE = {"seeds": 1, "robots": 60}
"""Settings of the run whose page the site shows."""

NOTEBOOKS = ROOT / "docs" / "notebooks"
DOWNLOAD = (
    '<p><a href="{name}.ipynb" download>Download this page as a notebook</a> for Jupyter. Run it '
    "in the root of the repository.</p>"
)

CELL = re.compile(r"^```python\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
"""A cell of a notebook."""

project = "tiswarm"
version = release = tiswarm.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_typehints_format = "short"
myst_heading_anchors = 3
exclude_patterns = ["joss"]  # for a journal, not for readers of the site
html_theme = "furo"
html_static_path, html_css_files = ["static"], ["site.css"]
html_title = f"tiswarm {version}"
html_show_copyright = html_copy_source = False


def read_page(_app: Sphinx, page: str, source: list[str]) -> None:
    """Fill in pages of the root, and lead links to them to their place on the site.

    No line ends within a number and the half width of its confidence interval.
    """
    if page in IN_ROOT:
        text = re.sub(r"\]\((?!https?:|#)", "](../", (ROOT / IN_ROOT[page]).read_text())
        _, first, last = [*source[0].split("\n---\n"), "", ""][:3]
        text = text.replace("](../docs/", "](")
        source[0] = (text.replace("\n## ", f"{first}\n## ", 1) if first else text) + last
    if page.startswith("notebooks/"):
        download = DOWNLOAD.format(name=Path(page).name)
        titled = re.sub(r"^# .*\n", rf"\g<0>\n{download}\n", source[0], count=1, flags=re.MULTILINE)
        source[0] = add_outputs(titled)
    for target, name in IN_ROOT.items():
        source[0] = re.sub(rf"\]\((\.\./)*{name}", f"](/{target}.md", source[0])
    # Other pages of the root go along as files.
    source[0] = re.sub(r"\]\(((\.\./)+[A-Z]+\.md)\)", r"](path:\1)", source[0])
    source[0] = re.sub(r"(?<=[\d)]) (?=± [\d.])|(?<=±) (?=[\d.])", "\N{NO-BREAK SPACE}", source[0])


def add_outputs(text: str) -> str:
    """Run the cells of a notebook in a copy of the root, and write below each what it shows."""
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("scenarios").symlink_to(ROOT / "scenarios")
        return CELL.sub(lambda cell: cell[0] + run_cell(cell[1], names), text)


def run_cell(code: str, names: dict[str, Any]) -> str:
    """Run a cell, and return what it prints and the value of its last line, as a notebook does."""
    *lines, last = ast.parse(code).body
    shows = isinstance(last, ast.Expr)
    before = ast.Module(lines if shows else [*lines, last], type_ignores=[])
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(before, "cell", "exec"), names)  # noqa: S102 - pages of this repository
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if shows else None  # noqa: S307
    shown = [f"<pre>{html.escape(printed.getvalue())}</pre>"] if printed.getvalue() else []
    shown += [] if value is None else [as_html(value)]
    inner = "\n".join(line for each in shown for line in each.splitlines() if line.strip())
    return f'\n```{{raw}} html\n<div class="output">\n{inner}\n</div>\n```\n' if shown else ""


def as_html(value: Any) -> str:  # noqa: ANN401 - any value that a cell ends with
    """Return a value as a notebook shows it."""
    if hasattr(value, "savefig"):
        stream = io.BytesIO()
        value.savefig(stream, format="png", dpi=150)
        data = base64.b64encode(stream.getvalue()).decode()
        wide = f"{72 * value.get_figwidth():.0f}"
        return f'<img alt="figure" width="{wide}" src="data:image/png;base64,{data}">'
    shown = value._repr_html_() if hasattr(value, "_repr_html_") else None
    return str(shown or f"<pre>{html.escape(repr(value))}</pre>")


def add_example(app: Sphinx, failed: Exception | None) -> None:
    """Run a small study, and add its page to the site."""
    if failed or app.builder.name != "html":
        return
    with tempfile.TemporaryDirectory() as folder:
        run = tiswarm.run(ROOT / "scenarios" / "tower.yaml", EXAMPLE, out=folder, quiet=True)
        shutil.copyfile(run.view(quiet=True), Path(app.outdir) / "example.html")


def add_notebooks(app: Sphinx, failed: Exception | None) -> None:
    """Write each notebook in the format of Jupyter beside its page."""
    if failed or app.builder.name != "html":
        return
    for page in NOTEBOOKS.glob("*.md"):
        notebook = Path(app.outdir) / "notebooks" / f"{page.stem}.ipynb"
        jupytext.write(jupytext.read(page), notebook)


def setup(app: Sphinx) -> None:
    """Read pages, and add an example and notebooks as above."""
    app.connect("source-read", read_page)
    app.connect("build-finished", add_example)
    app.connect("build-finished", add_notebooks)
