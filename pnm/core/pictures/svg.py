"""The frame of every picture: an SVG text with a white ground, so that it can be read on dark pages as well."""

from __future__ import annotations

import re
from collections.abc import Iterable
from html import escape
from typing import Final

from pnm.errors import printable_lines

_FRAME: Final = ".tip{fill:#78909c;stroke:none}.paper{fill:#fff;stroke:none}"


def xml(text: str) -> str:
    """Return a text as it stands in a picture: without what XML forbids, and with its marks written out."""
    return escape(printable_lines(text))


def cut(text: str, letters: int) -> str:
    """Return a text that has so many letters at most."""
    return text if len(text) <= letters else f"{text[: letters - 1]}…"


def picture(kind: str, title: str, style: str, width: float, height: float, parts: Iterable[str]) -> str:
    """Return the text of a picture of a kind, such as ``plan``, whose size is in pixels.

    The style is CSS for pictures of its kind alone: a notebook may have several on one page. It is empty if the page has looks for it.
    """
    size = f"{width:g}", f"{height:g}"
    looks = re.sub(r"[^{},]+(?=[,{])", rf".pnm-{kind} \g<0>", style + _FRAME) if style else ""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="pnm-{kind}" viewBox="0 0 {size[0]} {size[1]}" width="{size[0]}" height="{size[1]}"'
        f' role="img"><title>{xml(title)}</title>{looks and f"<style>{looks}</style>"}',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path class="tip" d="M0 0L8 4L0 8z"/></marker></defs>',
        f'<rect class="paper" width="{size[0]}" height="{size[1]}"/>',
        *parts,
        "</svg>",
    ]
    return "\n".join((*lines, ""))
