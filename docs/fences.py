"""A hook of `mkdocs.yml`: fences have the name of their language alone, because Python-Markdown reads no other words there."""

from __future__ import annotations

import re


def on_page_markdown(markdown: str, **_: object) -> str:
    """Return the text of a page, whose fences keep their first word."""
    return re.sub(r"^( *```\w+) .*$", r"\1", markdown, flags=re.MULTILINE)
