"""Text that goes into the page: escaped, and without a path of the machine that made it."""

import html
import re

# Where an absolute path begins, all of its folders: /a/b/name and C:\a\name leave name, gfpnet/top-down stays.
_FOLDERS = re.compile(r"(?<![\w./\\~-])(?:[A-Za-z]:)?[/\\]+(?:[^\s/\\'\"<>|:;,]+[/\\]+)*(?=[^\s/\\])")


def escaped(words: object) -> str:
    """Text as HTML, in an element or between the quotes of an attribute; of absolute paths the last name stays."""
    return html.escape(without_paths(str(words)))


def without_paths(words: str) -> str:
    """Text with the folders taken out of absolute paths."""
    return _FOLDERS.sub("", words)


def spoken(reason: str) -> str:
    """A reason as words."""
    return reason.replace("_", " ")
