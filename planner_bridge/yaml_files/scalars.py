"""Words and texts as YAML scalars: plain where every reader takes them for just that text, else in quotes.

YAML 1.1 takes ``on``, ``no``, ``1_000`` or ``12:30`` for something else than a text, YAML 1.2 ``0o17``; both do
so with numbers, and other characters mean something in some places only.
"""

from __future__ import annotations

import json
import re
from typing import Final

import yaml

_LETTERS: Final = frozenset("yYnN")
"""YAML 1.1 calls them truth values, too; PyYAML does not."""
_NEWER: Final = re.compile(
    r"0o[0-7]+|0x[0-9a-fA-F]+|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)|[-+]?(?:\.\d+|\d+(?:\.\d*)?)(?:[eE][-+]?\d+)?"
)
_PLAIN: Final = re.compile(
    r"(?![-?:](?:\s|\Z))(?![\s,\[\]{}#&*!|>'\"%@`=]|---|\.\.\.)[\x20-\x7e\xa0-\ud7ff\ue000-\ufefe\uff00-\ufffd]*(?<!\s)"
)
_BREAKING: Final = re.compile(r":(?:\s|\Z)|\s#|[\u2028\u2029]")
_IN_FLOW: Final = re.compile(r"[,\[\]{}?:]")
_ESCAPED: Final = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ud800-\udfff\ufffe\uffff]")
_RESOLVERS: Final = yaml.SafeLoader.yaml_implicit_resolvers


def scalar(text: str, *, in_flow: bool = False) -> str:
    """Write a text, which may have several lines.

    >>> scalar("hall"), scalar("on"), scalar("(at ?r hall)"), scalar("(at ?r hall)", in_flow=True)
    ('hall', '"on"', '(at ?r hall)', '"(at ?r hall)"')
    """
    return text if is_plain(text, in_flow=in_flow) else quoted(text)


def quoted(text: str) -> str:
    """Write a text in quotes."""
    return _ESCAPED.sub(lambda found: f"\\u{ord(found[0]):04x}", json.dumps(text, ensure_ascii=False))


def is_plain(text: str, *, in_flow: bool = False) -> bool:
    """Tell whether the text needs no quotes, inside brackets and braces or elsewhere."""
    if not any(map(str.isalnum, text)) or _PLAIN.fullmatch(text) is None or _BREAKING.search(text) or (in_flow and _IN_FLOW.search(text)):
        return False
    return text not in _LETTERS and _NEWER.fullmatch(text) is None and not _means_something(text)


def _means_something(text: str) -> bool:
    """Tell whether YAML 1.1 takes the text for a number, a truth value, a date or the like."""
    return any(pattern.match(text) for _, pattern in (*_RESOLVERS.get(text[0], ()), *_RESOLVERS.get(None, ())))
