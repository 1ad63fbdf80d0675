"""HTML that the pages have in common: the frame around them, and text that is escaped and names no folder."""

import html
import re
from importlib.resources import files

# Where an absolute path begins, all of its folders: /a/b/name and C:\a\name leave name, gfpnet/top-down stays.
_FOLDERS = re.compile(r"(?<![\w./\\~-])(?:[A-Za-z]:)?[/\\]+(?:[^\s/\\'\"<>|:;,]+[/\\]+)*(?=[^\s/\\])")


def html_page(title: str, body: str, *, css: str = "", script: str = "") -> str:
    """A whole page that asks nothing of any network.

    Args:
        title: The browser shows it; escaped here.
        body: HTML that stands inside of <main>.
        css: Rules that follow those which all pages share.
        script: HTML that follows <main>.
    """
    shared = files("gfp_grasp.drawing").joinpath("page.css").read_text(encoding="utf-8")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{html.escape(title)}</title>
<style>
{shared}{css}</style>
</head>
<body>
<main>
{body}
</main>
{script}</body>
</html>
"""


def escaped(words: object) -> str:
    """Text as HTML, for an element or the quotes of an attribute; an absolute path keeps its last name only."""
    return html.escape(without_paths(str(words)))


def without_paths(words: str) -> str:
    """Text in which each absolute path has lost its folders."""
    return _FOLDERS.sub("", words)


def spoken(reason: str) -> str:
    """A reason as words."""
    return reason.replace("_", " ")
