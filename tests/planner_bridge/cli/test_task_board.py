"""What `pnm watch` keeps in sight on a terminal of 80 columns."""

import io
from uuid import UUID

from rich.console import Console

from planner_bridge.cli.running_node import Event, TaskBoard
from pnm.tasks import TraceKind

TEA, POST = UUID(int=0xAAAAAAAA << 96), UUID(int=0xBBBBBBBB << 96)


def lines(board: TaskBoard, now: float) -> list[str]:
    console = Console(file=io.StringIO(), width=80)
    console.print(board.shown(now))
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def note(board: TaskBoard, task: UUID, kind: TraceKind, subject: str, text: str, now: float) -> None:
    board.note(Event(task, kind, kind.word, subject, text, now), now)


def test_tasks_that_are_not_over_and_their_calls_stay_in_sight() -> None:
    board = TaskBoard()
    note(board, TEA, TraceKind.GOAL, "", "(has ada tea)", 0)
    note(board, TEA, TraceKind.STATE, "", "running", 0)
    note(board, TEA, TraceKind.SENT, "move(r1, hall, kitchen)", "", 1)
    note(board, TEA, TraceKind.FEEDBACK, "move(r1, hall, kitchen)", "distance_remaining 1.2", 2)
    note(board, POST, TraceKind.GOAL, "", "(at post [hall])", 2)
    note(board, POST, TraceKind.STATE, "", "queued: waits for (at r1 dock): it would change (at r1 hall), which the other needs", 2)
    assert lines(board, 13) == [
        "aaaaaaaa  (has ada tea)  running",
        "    12 s  move(r1, hall, kitchen)  distance_remaining 1.2",
        "bbbbbbbb  (at post [hall])  queued: waits for (at r1 dock): it would change (at",
        "          r1 hall), which the other needs",
    ]
    note(board, TEA, TraceKind.ENDED, "move(r1, hall, kitchen)", "succeeded", 14)
    assert [line.split()[0] for line in lines(board, 14)] == ["aaaaaaaa", "bbbbbbbb", "r1"]
    note(board, POST, TraceKind.STATE, "", "over: cancelled: its client has cancelled it", 15)
    note(board, TEA, TraceKind.STATE, "", "over: goal_reached: the goal holds", 15)
    assert lines(board, 15) == []
