"""The site that `make docs` builds from the README, these pages and the docstrings."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

project = "gfp_grasp"
author = "The gfp_grasp authors"
copyright = author
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
html_theme = "furo"
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "imported-members": True, "show-inheritance": True}
napoleon_numpy_docstring = False
napoleon_use_ivar = True


def readme_first(app, docname: str, source: list[str]) -> None:
    """The start page is the README, its links as seen from this folder."""
    if docname == "index":
        text = (ROOT / "README.md").read_text(encoding="utf-8")
        text = re.sub(r"\]\((CONTRIBUTING|CHANGELOG)\.md", lambda match: f"](docs/{match[1].lower()}.md", text)
        text = re.sub(r"\]\((?!https?:|docs/)", "](../", text).replace("](docs/", "](")
        source[0] = f"{text}\n{source[0]}"


def tables_as_they_are(app, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Tables of docstrings, which are written as Markdown has them, in a block of their own."""
    shown: list[str] = []
    for line in lines:
        in_table = line.lstrip().startswith("|")
        if in_table and not (shown and shown[-1].lstrip().startswith("|")):
            indent = line[: len(line) - len(line.lstrip())]
            shown += [f"{indent}.. code-block:: text", ""]
        shown.append(f"   {line}" if in_table else line)
    lines[:] = shown


def setup(app) -> None:
    """Connect both."""
    app.connect("source-read", readme_first)
    app.connect("autodoc-process-docstring", tables_as_they_are)
