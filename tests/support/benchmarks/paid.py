"""What users pay, beside floors that were set: each row along the way that `pnm` takes, in one run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log
from typing import Final

from tests.support.benchmarks.executives.page import number
from tests.support.benchmarks.executives.workers import Worker, value_of

BEGIN: Final = "<!-- measured: python -m tests.benchmarks --paid --write -->\n"
END: Final = "<!-- end of what is paid -->\n"
_TIMES: Final = 3.0
"""How often the floor a row may take, if nothing else is said."""


@dataclass(frozen=True, slots=True)
class Paid:
    """Something that users pay.

    Args:
        floor: the least that it can take, in the unit; or the measure of that, in the same run.
        at_most: the bound, in the unit; `_TIMES` the floor if it is 0.
        less: a measure of what is there in any case, and does not count.
        is_each: whether the unit is for each of so many, so that all of them take as many times as much.
        rounds: how often it is measured at most.
    """

    what: str
    measure: str
    sizes: tuple[int, ...]
    unit: str
    floor: float | str
    at_most: float = 0.0
    less: str = ""
    is_each: bool = False
    rounds: int = 100


PAID: Final = (
    Paid("the memory that 100 goals leave behind, of so many after the first 500", "left-behind", (1_000,), "MB", 0.0, 0.1, rounds=1),
    Paid("a change of a fact that none reads, beside so many conditions over all", "change-unread", (10, 1_000), "µs", 3.4, less="rounds"),
    Paid("the same below one condition over all of so many objects", "lamp-unread", (100, 10_000), "µs", 5.0, less="rounds"),
    Paid("a report of one fact, in a world of so many", "report", (100, 100_000), "µs", 5.0),
    Paid("what rules derive in a grid of so many places, after a change", "ways", (50, 200), "µs", 1_000.0),
    Paid("from a goal to its first request, of so many tasks at once", "tasks-begin", (10, 500), "µs", 9_000.0, is_each=True),
    Paid("the same where actions have durations", "tasks-begin-timed", (10, 100), "µs", 9_000.0, is_each=True),
    Paid("from the end of a call to the next request, among so many tasks", "tasks-next", (10, 500), "µs", 600.0),
    Paid("a call of a plan by hand, of so many: read, proved, carried out", "written", (100, 1_000), "µs", 300.0, is_each=True),
    Paid("a call of a task, of so many", "task-call", (100, 1_000), "µs", 50.0, is_each=True),
    Paid("the same with a journal", "task-call-kept", (100, 1_000), "µs", 50.0, 350.0, is_each=True),
    Paid("an action of a domain in YAML that is imported, of so many", "import", (100, 1_800), "µs", 650.0, is_each=True),
    Paid("to take up the journal of a task that has not ended, after so many calls", "taken-up", (2_000, 10_000), "µs", 5_000.0),
    Paid("a plan for so many tiles a side, which is hard to find; Kairos alone", "plan-tiles", (4,), "ms", "plan-tiles-kairos", rounds=1),
    Paid("`pnm --help`", "help", (1,), "ms", 200.0),
    Paid("`pnm run -q`, simulated robots, to the end", "simulated", (1,), "ms", 300.0),
)


def paid(worker: Worker, rounds: int) -> Iterator[str]:
    """Measure everything some times, and yield a table of the least that each has taken, in Markdown, line by line."""
    yield "| what | how many | takes | floor | times the floor | at most | exponent |"
    yield "|---|---:|---:|---:|---:|---:|---:|"

    def least(name: str, size: int) -> float:
        return min(value_of(worker, name, size) for _ in range(min(rounds, row.rounds)))

    for row in PAID:
        takes = [least(row.measure, size) - (least(row.less, size) if row.less else 0.0) for size in row.sizes]
        floor = row.floor if isinstance(row.floor, float) else least(row.floor, row.sizes[-1])
        times = f"{number(max(takes) / floor)}" if floor else ""
        growth = f"{exponent(row, takes):.2f}" if len(row.sizes) > 1 else ""
        cells = (", ".join(f"{size:,}" for size in row.sizes), f"{', '.join(map(number, takes))} {row.unit}", f"{number(floor)} {row.unit}")
        yield f"| {row.what} | {' | '.join(cells)} | {times} | {number(row.at_most or _TIMES * floor)} {row.unit} | {growth} |"


def exponent(row: Paid, takes: list[float]) -> float:
    """Return the exponent with which the time of all grows from the first size to the last."""
    return log(max(takes[-1], 1e-9) / max(takes[0], 1e-9)) / log(row.sizes[-1] / row.sizes[0]) + row.is_each
