"""Settings of the site, which `make docs` builds from these pages."""

import re
import shutil
import tempfile
from pathlib import Path

from sphinx.application import Sphinx

import tiswarm

ROOT = Path(__file__).parents[1]
IN_ROOT = {"index": "README.md", "contributing": "CONTRIBUTING.md", "changelog": "CHANGELOG.md"}
"""Pages of the site whose text stands in the root of the repository."""

EXAMPLE = {"seeds": 1, "robots": 60}
"""Settings of the run whose page the site shows."""

project = "tiswarm"
version = release = tiswarm.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_typehints_format = "short"
myst_heading_anchors = 3
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
    for target, name in IN_ROOT.items():
        source[0] = re.sub(rf"\]\((\.\./)*{name}", f"](/{target}.md", source[0])
    source[0] = re.sub(r"(?<=[\d)]) (?=± [\d.])|(?<=±) (?=[\d.])", "\N{NO-BREAK SPACE}", source[0])


def add_example(app: Sphinx, failed: Exception | None) -> None:
    """Run a small study, and add its page to the site."""
    if failed or app.builder.name != "html":
        return
    with tempfile.TemporaryDirectory() as folder:
        run = tiswarm.run(ROOT / "scenarios" / "tower.yaml", EXAMPLE, out=folder, quiet=True)
        shutil.copyfile(run.view(quiet=True), Path(app.outdir) / "example.html")


def setup(app: Sphinx) -> None:
    """Read pages and add an example as above."""
    app.connect("source-read", read_page)
    app.connect("build-finished", add_example)
