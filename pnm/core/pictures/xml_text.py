"""XML: the frame of every picture, an SVG text with a white ground, so that it can be read on dark pages as well; and the reader of files.

Files come from anywhere: a document type, and with it every entity, is refused, and so is what is nested too deeply, or too much.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from itertools import count
from types import MappingProxyType
from typing import Final
from xml.parsers import expat

from pnm.errors import InputError, Position, printable_lines

TOKENS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "bg": ("#f4f5f8", "#0b0d11"),
        "surface": ("#fff", "#12151b"),
        "raised": ("#f8f9fb", "#171b22"),
        "line": ("#e2e5eb", "#242a34"),
        "edge": ("#868f9d", "#6b7686"),
        "hover": ("#eef1f6", "#1c212a"),
        "sel": ("#fff", "#222833"),
        "track": ("#d3d8e0", "#3a4350"),
        "future": ("#f6f7fa", "#181c24"),
        "text": ("#12161d", "#e9ecf1"),
        "dim": ("#545e6d", "#9aa5b5"),
        "run": ("#1d5bd6", "#7db0ff"),
        "run-s": ("#e6eefd", "#172742"),
        "on-run": ("#fff", "#0a1426"),
        "ok": ("#10693b", "#5fd09a"),
        "ok-s": ("#e2f3e9", "#11291e"),
        "ok-e": ("#8cc5a4", "#2c6a4a"),
        "bad": ("#b3221b", "#ff8a80"),
        "bad-s": ("#fcebe9", "#341816"),
        "on-bad": ("#fff", "#2b0806"),
        "ask": ("#8a5200", "#f0bd5d"),
        "ask-s": ("#fff5df", "#2a2110"),
        "ask-e": ("#e0b662", "#7a5c1f"),
        "ask-b": ("#a35f00", "#f0bd5d"),
        "on-ask": ("#fff", "#221700"),
        "cut": ("#6438bd", "#bda4ff"),
        "cut-s": ("#f0eafc", "#221b39"),
        "glow": ("#1d5bd640", "#7db0ff50"),
    }
)
"""The colours of pictures and of the page, light and dark, by their names.

What runs is blue, what is done green, what has failed red, what needs a person amber, and a new plan violet.
"""
COLOUR: Final = {name.replace("-", "_"): light for name, (light, _) in TOKENS.items()}
"""Those of a picture, which is light everywhere."""
_FRAME: Final = ".tip{{fill:{edge};stroke:none}}.paper{{fill:{surface};stroke:none}}".format_map(COLOUR)


def xml(text: str) -> str:
    """Return a text as it stands in a picture: without what XML forbids, and with its marks written out."""
    return escape(printable_lines(text))


def cut(text: str, letters: int) -> str:
    """Return a text that has so many letters at most."""
    return text if len(text) <= letters else f"{text[: letters - 1]}…"


def short(text: str, letters: int) -> str:
    """Return a text as it stands in a picture, with so many letters at most, and whole where it is pointed at if it is cut."""
    shown = cut(text, letters)
    return xml(shown) if shown == text else f"{xml(shown)}<title>{xml(text)}</title>"


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


# --- reading ----------------------------------------------------------------------------------


_DEEPEST: Final = 100
"""Elements inside of each other, at most: readers call themselves for each level."""
MOST_ELEMENTS: Final = 10**6
"""Of a file: as `<b/>`, a hundred megabytes could have 25 million."""


@dataclass(slots=True)
class Element:
    """An element of a file. Text and contents grow only while it is read."""

    tag: str
    """Without its namespace."""
    namespace: str
    attributes: Mapping[str, str]
    position: Position
    text: str = ""
    """Its own, without that of its contents."""
    contents: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Yield the elements directly inside of it that have a tag."""
        return (one for one in self.contents if one.tag == tag)

    def of(self, name: str) -> str:
        """Return an attribute; raise `InputError` if it is missing."""
        if name not in self.attributes:
            raise InputError(f"<{self.tag}> lacks its attribute {name!r}", self.position)
        return self.attributes[name]


def read_xml(text: str, file: str) -> Element:
    """Return the outermost element of a text; raise `InputError` if it is not well-formed, or too large, or has a document type."""
    parser, path, root, numbers = expat.ParserCreate(namespace_separator=" "), list[Element](), list[Element](), count(1)

    def here() -> Position:
        return Position(file, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def begin(tag: str, attributes: dict[str, str]) -> None:
        namespace, _, name = tag.rpartition(" ")
        element = Element(name, namespace, attributes, here())
        if len(path) >= _DEEPEST:
            raise InputError(f"<{name}> is nested too deeply; expected {_DEEPEST} levels at most", element.position)
        if next(numbers) > MOST_ELEMENTS:
            raise InputError(f"expected {MOST_ELEMENTS} elements at most", element.position)
        (path[-1].contents if path else root).append(element)
        path.append(element)

    def add(letters: str) -> None:
        path[-1].text += letters

    def refuse(*_: object) -> None:
        raise InputError("expected no document type: entities and other files are not read", here())

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = begin, lambda _: path.pop()
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = add, refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        position = Position(file, error.lineno, error.offset + 1)
        raise InputError(f"not XML: {expat.ErrorString(error.code)}", position) from error
    return root[0]
