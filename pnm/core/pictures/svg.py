"""What all pictures are made of: the frame of an SVG text, with a white ground, so that it can be read on dark pages as well."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


def picture(title: str, style: str, width: float, height: float, parts: Iterable[str]) -> str:
    """Return the text of a picture of so many pixels."""
    size = f"{width:g}", f"{height:g}"
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" width="{size[0]}" height="{size[1]}" role="img">',
        f"<title>{escape(title)}</title><style>{style}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8z" style="fill:#78909c;stroke:none"/></marker></defs>',
        f'<rect width="{size[0]}" height="{size[1]}" style="fill:#fff;stroke:none"/>',
        *parts,
        "</svg>",
    ]
    return "\n".join((*lines, ""))
