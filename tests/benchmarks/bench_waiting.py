"""What runs cost that wait: for facts to change, and for resources. Not a test: `python tests/benchmarks/bench_waiting.py`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from planner_bridge.tasks.settings import OnChange
from tests.support.benchmarks.waiting import CHARGE, constrained, fact, heard, taking_turns


def changes() -> None:
    """A fact changes: one that nothing mentions, and one that one of many conditions over all, or constraints, does."""
    for count in (100, 1_000):
        for on_change in OnChange:
            of_none, of_one = (fact(count, on_change, fluent) for fluent in (("other",), CHARGE))
            print(f"a change among {count} calls, {on_change.value}: {of_none:.1f} us if none reads it, {of_one:.1f} us if one does")
        world, look = constrained(10 * count)
        of_none, of_one = (heard(world, look, fluent) for fluent in (("other",), ("fit", "r5")))
        print(f"a change among {10 * count} constraints: {of_none:.1f} us if none reads it (at most 5), {of_one:.1f} us if one does (50)")


def one_resource() -> None:
    """Runs that all want the same resource."""
    costs = ", ".join(f"{count}: {taking_turns(count):.0f} us" for count in (25, 200, 1_000))
    print(f"runs that want one resource: {costs} a call")


if __name__ == "__main__":
    changes()
    one_resource()
