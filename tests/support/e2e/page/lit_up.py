"""What lights up in the plan on a page, and whether that was so, and in that order, by the journal."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Final

from planner_bridge.view.follow import Reader
from planner_bridge.view.story import view_of
from tests.support.e2e.page.journals import steps

WATCH: Final = """
window.seen = [];
const note = (changes) => {
  const batch = [];
  for (const { target, oldValue } of changes) {
    const { step, state } = target.dataset;
    if (step && state && state !== oldValue) batch.push([target.closest("svg").dataset.run, Number(step), state]);
  }
  if (batch.length) window.seen.push(batch);
};
const what = { subtree: true, attributeFilter: ["data-state"], attributeOldValue: true };
addEventListener("DOMContentLoaded", () => new MutationObserver(note).observe(document.getElementById("picture"), what));
"""
"""Notes which boxes of the plan change their states, all that do so at the same time together."""


def told(journal: Path) -> list[tuple[str, int, str]]:
    """Every state that a call has had, in the order of the journal."""
    reader, last, changes = Reader(journal), dict[str, str](), list[tuple[str, int, str]]()
    for step in steps(journal):
        view = reader.at(step.number, view_of)
        for key, call in view.calls.items() if view else ():
            if last.get(key) != call.state:
                changes.append((call.run, call.index, call.state))
                last[key] = call.state
    return changes


def in_order(seen: list[list[tuple[str, int, str]]], kept: list[tuple[str, int, str]]) -> None:
    """What has lit up is in the journal, and in its order: all that was seen at one time is before what was seen later."""
    places = defaultdict[tuple[str, int, str], list[int]](list)
    for number, change in enumerate(kept):
        places[change].append(number)
    batches = [[places[run, step, state] for run, step, state in batch] for batch in seen]
    assert all(all(batch) for batch in batches), "nothing is shown that is not so"
    for before, after in pairwise(batches):
        assert max(map(min, before)) < min(map(max, after))
    assert {state for batch in seen for _, _, state in batch} >= {"running", "succeeded"}
    lit = [change for batch in seen for change in batch if change[2] == "running"]
    assert len(lit) >= 8
