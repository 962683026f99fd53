"""What `pnm watch` keeps in sight on a terminal of 80 columns."""

import io
from uuid import UUID

from rich.console import Console

from planner_bridge.cli.console import ToldFailures
from planner_bridge.cli.running_node import TaskBoard
from pnm.tasks import TraceEvent, TraceKind

TEA, POST = UUID(int=0xAAAAAAAA << 96), UUID(int=0xBBBBBBBB << 96)


def lines(board: TaskBoard, now: float) -> list[str]:
    console = Console(file=io.StringIO(), width=80)
    console.print(board.shown(now))
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def note(board: TaskBoard, task: UUID, kind: TraceKind, subject: str, text: str, now: float) -> None:
    board.note(TraceEvent(task, now, kind, subject, text), now)


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


def test_a_request_to_cancel_is_no_call() -> None:
    board = TaskBoard()
    note(board, TEA, TraceKind.STATE, "", "running", 0)
    note(board, TEA, TraceKind.SENT, "move(r1, hall, kitchen)", "", 1)
    note(board, TEA, TraceKind.SENT, "", "a request to cancel move(r1, hall, kitchen): it has not ended within 30 s", 31)
    assert lines(board, 33) == ["aaaaaaaa    running", "    32 s  move(r1, hall, kitchen)"]


def test_a_failure_is_told_once() -> None:
    failures, move, blocked = ToldFailures(), "move(r1, hall, kitchen)", "aborted: the way is blocked"

    def told(task: UUID, kind: TraceKind, subject: str, text: str) -> str:
        return failures.words(TraceEvent(task, 0.0, kind, subject, text)).removeprefix(f"{subject}: ")

    assert told(TEA, TraceKind.ENDED, move, blocked) == blocked
    assert told(POST, TraceKind.FAILED, f"{move}#4", blocked) == blocked, "that is another task"
    assert told(TEA, TraceKind.FAILED, f"{move}#4", blocked) == "it is not tried again in this plan"
    assert told(TEA, TraceKind.FAILED, f"{move}#4", blocked) == blocked
    told(TEA, TraceKind.ENDED, move, "canceled: cancelled on request")
    late = "timed_out: expected an end within 30 s; observed none; then cancelled on request"
    assert told(TEA, TraceKind.FAILED, f"{move}#4", late) == late
    told(TEA, TraceKind.ENDED, move, blocked)
    told(TEA, TraceKind.STATE, "", "over: cancelled: its client has cancelled it")
    assert failures.ends == {}
