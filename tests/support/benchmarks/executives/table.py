"""The rows of the benchmark: what is measured, of which size, and who takes part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

LARGE: Final = 10_000
"""From here on some peers take minutes to build what is measured."""


@dataclass(frozen=True, slots=True)
class Subject:
    """One that is measured.

    Args:
        label: its name in the table.
        measure: the name of its measure.
        does_less: whether it is a floor, which checks or proves less than the rest of its row, and no rival.
        is_peer: whether it runs in the environment of the peers.
        largest: the largest size at which it is measured.
    """

    label: str
    measure: str
    does_less: bool = False
    is_peer: bool = False
    largest: int = 1_000_000

    @property
    def is_ours(self) -> bool:
        """Whether it is this project, in one way or another."""
        return self.label.startswith("ours")


@dataclass(frozen=True, slots=True)
class Row:
    """Something that is measured, ours first; less is better.

    Args:
        what: a title.
        means: how to read it.
        unit: of the numbers.
        item: of which there are so many.
        sizes: how many.
        subjects: who takes part.
        rounds: how often each is measured at most; `LARGE` sizes are measured once.
    """

    what: str
    means: str
    unit: str
    item: str
    sizes: tuple[int, ...]
    subjects: tuple[Subject, ...]
    rounds: int = 5


def peer(label: str, measure: str, *, does_less: bool = False, largest: int = 1_000_000) -> Subject:
    """Return a subject in the environment of the peers."""
    return Subject(label, measure, does_less, True, largest)


def floor(label: str, measure: str) -> Subject:
    """Return a subject of plain Python."""
    return Subject(label, measure, does_less=True)


_NETS: Final = (100, 1_000, 10_000)
_CALLS: Final = (1_000, 10_000)

_WALL: Final = "By the clock on the wall: where others are busy, the ratios do not hold."

ROWS: Final = (
    Row(
        "A call of a plan by hand, as users run it",
        "A file with a plan is read, proved and carried out as a task, as by `pnm run --plan`; its robots are simulated and take no time. "
        "Of that is the executor by itself, with no file, no task and no robots.",
        "µs",
        "calls",
        (100, 1_000),
        (
            Subject("ours", "written"),
            Subject("ours, with a journal", "written-kept"),
            floor("of which the executor", "call-asynchronous"),
            peer("UP-ESB, its executor", "esb-row", does_less=True),
        ),
        rounds=3,
    ),
    Row(
        "A call of a task that is under way",
        "By the task manager, from the first request of a goal to its end: its plan was found and proved before. Robots do everything at "
        "once. Of that is the executor by itself.",
        "µs",
        "calls",
        (100, 1_000),
        (
            Subject("ours", "task-call"),
            Subject("ours, with a journal", "task-call-kept"),
            floor("of which the executor", "call-asynchronous"),
            peer("UP-ESB, its executor", "esb-row", does_less=True),
        ),
        rounds=3,
    ),
    Row(
        "A command, whole process",
        "The delivery of a packet by simulated robots, to the end.",
        "ms",
        "delivery",
        (1,),
        (Subject("ours, `pnm run -q`", "simulated"), Subject("ours, `pnm --help`", "help"), floor("Python, which does nothing", "python")),
    ),
    Row(
        "A firing, chain",
        "A net in which one transition follows the other. A run decides conditions, sends requests and keeps results besides.",
        "µs",
        "transitions",
        _NETS,
        (
            Subject("ours, engine", "engine-chain"),
            Subject("ours, run", "run-chain"),
            peer("SNAKES", "snakes-chain"),
            peer("pm4py", "pm4py-chain"),
            floor("counters in Python", "counters-chain"),
        ),
    ),
    Row(
        "A firing, fork-join of 8",
        "The same where eight branches begin at once and join again.",
        "µs",
        "transitions",
        _NETS,
        (
            Subject("ours, engine", "engine-fork"),
            Subject("ours, run", "run-fork"),
            peer("SNAKES", "snakes-fork"),
            peer("pm4py", "pm4py-fork"),
            floor("counters in Python", "counters-fork"),
        ),
    ),
    Row(
        "A checked call, in a row",
        "An action that does nothing, with two preconditions and an effect that are checked. Ours is answered at once; known: the machine "
        "was executed before.",
        "µs",
        "calls",
        _CALLS,
        (
            Subject("ours", "call-inline"),
            Subject("ours, known", "call-known"),
            peer("UP-ESB", "esb-row"),
            peer("py_trees", "trees-row"),
            peer("SMACH", "smach-row"),
        ),
    ),
    Row(
        "A checked call, asynchronous, in a row",
        "The same by the executor of each, with an action that is done in the next round of the event loop; py_trees with leaves that run "
        "for a tick.",
        "µs",
        "calls",
        _CALLS,
        (
            Subject("ours, `Executor`", "call-asynchronous"),
            peer("UP-ESB", "esb-row"),
            peer("py_trees", "trees-running"),
            floor("asyncio tasks", "tasks-row"),
        ),
    ),
    Row(
        "A checked call, in parallel",
        "All calls at once. SMACH starts a thread for each; UP-ESB has none of this.",
        "µs",
        "calls",
        (1_000,),
        (
            Subject("ours", "calls-parallel"),
            peer("py_trees", "trees-parallel"),
            peer("SMACH", "smach-parallel"),
            floor("asyncio tasks", "tasks-parallel"),
        ),
    ),
    Row(
        "From a plan to what is executed, a call",
        "Ours: causal links, net, proof of soundness, compilation. UP-ESB makes a graph in the order of the plan and proves nothing.",
        "µs",
        "calls",
        (100, 1_000, 10_000),
        (
            Subject("ours", "machine"),
            peer("UP-ESB", "esb-graph", does_less=True),
            peer("unified-planning, partial order", "up-partial-order", does_less=True, largest=1_000),
        ),
        rounds=3,
    ),
    Row(
        "A change of a fact",
        "A report comes while so many calls of a task are under way, from its goal on as in `pnm run`, each with a condition over all; one "
        f"of these reads it. The rounds of the event loop are included. {_WALL} No peer here checks such conditions.",
        "µs",
        "conditions",
        (10, 100, 1_000),
        (Subject("ours", "change"), Subject("ours, read by none", "change-unread"), floor("all conditions judged", "change-unindexed")),
    ),
    Row(
        "A change below a condition over all objects",
        "The same while one call is under way, on the condition that a fact is so of every one of so many objects.",
        "µs",
        "objects",
        (100, 1_000, 10_000),
        (Subject("ours", "lamp"), Subject("ours, of another fact", "lamp-unread"), floor("all objects looked at", "lamps-looked-at")),
    ),
    Row(
        "A report of one fact",
        "Where a robot is, as its sensor reports it, which is another one each time, in a world of so many other facts.",
        "µs",
        "facts",
        (100, 10_000, 100_000),
        (Subject("ours", "report"),),
    ),
    Row(
        "What is reached in a grid, after a change",
        "A way between two places is closed, or opened; then all places are asked for whether rules derive a way to them from a corner. "
        "At first: in a world of which nothing has been asked.",
        "µs",
        "places",
        (50, 100, 200),
        (Subject("ours", "ways"), Subject("ours, at first", "ways-first"), floor("a search in plain Python", "ways-searched")),
    ),
    Row(
        "Runs that want one resource, a call",
        "Each hears of it whenever it may be free. No peer here shares resources among plans.",
        "µs",
        "runs",
        (100, 1_000),
        (Subject("ours", "resource"), floor("asyncio tasks, a lock", "locked")),
        rounds=2,
    ),
    Row(
        "A plan that the planner's first way of searching does not find soon",
        "Two robots paint the tiles of a square like a chessboard. Ours waits for half a second before it tries other ways.",
        "ms",
        "tiles a side",
        (4,),
        (Subject("ours", "plan-tiles"), Subject("kairos, a thread for each core", "plan-tiles-kairos", does_less=True)),
        rounds=3,
    ),
    Row(
        "The search for needless calls in a plan",
        "Each call has to be tried, and without it all others are simulated.",
        "ms",
        "calls",
        (250, 1_000, 4_000),
        (Subject("ours", "needless"), floor("one simulation of the plan", "valid")),
        rounds=2,
    ),
    Row(
        "From a failure to the first request of the new plan",
        "A robot inspects places, and its first inspections fail: nearly all of the plan is made anew. "
        f"{_WALL} "
        "UP-ESB does not execute the plan that its callback returns.",
        "ms",
        "calls",
        (20, 200),
        (Subject("ours", "failure"), floor("of which the planner and its validation", "failure-planner")),
        rounds=3,
    ),
    Row(
        "From files to the first request, whole process",
        f"A tour of a mall (`problems/mall/p01.pddl`). The others end with a plan, ours with a proved machine that has begun. {_WALL}",
        "ms",
        "problem",
        (1,),
        (
            Subject("ours", "first-request"),
            Subject("kairos, the planner alone", "first-plan-kairos", does_less=True),
            Subject("unified-planning with Aries", "first-plan-up", does_less=True),
        ),
    ),
    Row(
        "A goal over ROS 2",
        f"A server of rclpy that succeeds at once, in a process of its own; so many goals in flight. {_WALL}",
        "ms",
        "in flight",
        (1, 10, 100),
        (Subject("ours", "ros-ours"), Subject("rclpy's ActionClient", "ros-bare")),
        rounds=3,
    ),
)
