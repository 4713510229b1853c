"""Settings of the site, which `make docs` builds from these pages."""

import re
from pathlib import Path

from sphinx.application import Sphinx

import tiswarm

ROOT = Path(__file__).parents[1]
IN_ROOT = {"index": "README.md", "contributing": "CONTRIBUTING.md", "changelog": "CHANGELOG.md"}
"""Pages of the site whose text stands in the root of the repository."""

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
        source[0] = text.replace("](../docs/", "](") + source[0].partition("---")[2]
    for target, name in IN_ROOT.items():
        source[0] = re.sub(rf"\]\((\.\./)*{name}", f"](/{target}.md", source[0])
    source[0] = re.sub(r"(?<=[\d)]) (?=± [\d.])|(?<=±) (?=[\d.])", "\N{NO-BREAK SPACE}", source[0])


def setup(app: Sphinx) -> None:
    """Read pages as above."""
    app.connect("source-read", read_page)
