"""The measured part of the page docs/reference/benchmarks.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from typing import Any, Final

from tests.support.benchmarks.executives.measured import MeasuredRow, Taken
from tests.support.files import ROOT

PAGE: Final = ROOT / "docs" / "reference" / "benchmarks.md"
BEGIN: Final = "<!-- measured: python -m tests.benchmarks --write -->\n"
END: Final = "<!-- end of what is measured -->\n"


def measured_part(rows: Iterable[MeasuredRow], machine: Mapping[str, Any], peers: Mapping[str, str], rounds: int) -> str:
    """Return the machine, a table for every row, and what is slower than a peer, in Markdown."""
    rows = list(rows)
    named = ", ".join(f"{name} {version}" for name, version in peers.items()) or "none was installed"
    text = f"Measured on {machine['cpu']}, {machine['cores']} cores (load {machine['load']}), Python {machine['python']}, "
    text += f"{rounds} rounds at most. Peers: {named}.\n\n### Where this project is slower\n\n"
    for row in rows:
        slower = "; ".join(f"{ours} {ratio:.1f} × {rival}" for ours, ratio, rival in row.slower)
        text += f"- {row.row.what}, {row.size} {row.row.item}: {slower}\n" if slower else ""
    text += "" if any(any(row.slower) for row in rows) else "Nowhere.\n"
    for row, group in groupby(rows, key=lambda measured: measured.row):
        text += f"\n### {row.what}\n\n{row.means}\n\n"
        text += f"| {row.item} | {' | '.join(subject.label + (' *' if subject.does_less else '') for subject in row.subjects)} |\n"
        text += f"|---:|{'---:|' * len(row.subjects)}\n"
        for measured in group:
            cells = (cell(taken, measured.taken[0], row.unit) for taken in measured.taken)
            text += f"| {measured.size} | {' | '.join(cells)} |\n"
    return text


def cell(taken: Taken, ours: Taken, unit: str) -> str:
    """Return what a subject has taken, and how often as long ours takes; or why it has taken no part."""
    if not taken.values:
        return taken.absent
    shown = f"{number(taken.median)} {unit} ({number(min(taken.values))} to {number(max(taken.values))})"
    ratio = ours.times(taken)
    return shown if taken.subject.is_ours or ratio is None else f"{shown}, {number(ratio)} ×"


def number(value: float) -> str:
    """Return a number with two digits at least."""
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"


def put_in(text: str, part: str, begin: str = BEGIN, end: str = END) -> str:
    """Return the page with a measured part replaced, which is between these lines."""
    before, rest = text.split(begin)
    return f"{before}{begin}\n{part}\n{end}{rest.split(end)[1]}"
