"""Picture of a plan as Graphviz text: a box per step, an arrow where one waits for another, with the facts it waits for.

What a step holds stands in a frame, to which a dotted arrow leads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from pnm.core.machine.plan_graph import Flow, PlanGraph
from pnm.core.pictures.export import quoted
from pnm.core.pictures.plan_layout import laid_out
from pnm.core.pictures.step_words import cut, facts_of, held, words_of

_LETTERS: Final = 40


def plan_dot(plan: PlanGraph) -> str:
    """Return the picture of a plan; the same plan gives the same text."""
    look = 'node [shape=box, style=rounded, fontname="sans-serif", fontsize=11]; edge [fontname="sans-serif", fontsize=9]'
    lines = ["digraph plan {", f"  rankdir=LR; {look};", *_steps(plan.flow, "  ")]
    for step in plan.every_step:
        for number, (title, flow) in enumerate(held(step)):
            lines.append(
                f'  subgraph cluster_{step.index}_{number} {{ label={quoted(title)}; color=gray; fontname="sans-serif"; fontsize=10;'
            )
            lines += (*_steps(flow, "    "), "  }")
            later = {arrow.after for arrow in laid_out(flow).arrows if not arrow.is_for_the_end}
            lines += (f"  {step.index} -> {first.index} [style=dotted];" for first in flow.steps if first.index not in later)
    return "\n".join((*lines, "}", ""))


def _steps(flow: Flow, indent: str) -> Iterator[str]:
    """Yield steps in the order of time, which is the order in which Graphviz places them, and their arrows."""
    layout = laid_out(flow)
    for cell in sorted(layout.cells.values(), key=lambda cell: (cell.line, cell.column, cell.row)):
        words = words_of(cell.step)
        label = f"{words.name}  #{cell.step.index}\n{cut(words.what, _LETTERS)}"
        yield f"{indent}{cell.step.index} [label={quoted(label)}, tooltip={quoted(words.whole)}];"
    for arrow in layout.arrows:
        look = ", style=dashed, constraint=false" if arrow.is_for_the_end else ""
        label = f"ends after {facts_of(arrow.protects, _LETTERS)}".rstrip() if arrow.is_for_the_end else facts_of(arrow.protects, _LETTERS)
        yield f"{indent}{arrow.before} -> {arrow.after} [label={quoted(label)}{look}];"
