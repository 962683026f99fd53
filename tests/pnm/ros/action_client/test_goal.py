"""Goals on their way: what is concluded from who is in the graph, on a clock that only tests move; and feedback on one line."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PolygonStamped, PoseStamped
from pnm_interfaces.action import GroundAction, RunPlan
from test_msgs.action import Fibonacci, NestedMessage
from test_msgs.msg import Arrays, BasicTypes, Nested

from pnm.ros.action_client.goal import AGAIN, ASKS, GRACE, LENGTH, PATIENT_ASKS, Liveness, Verdict, feedback_line

OLD, NEW = b"old", b"new"


def looks(watch, present, *, over=False, start=0.0, end=60.0):
    """Look four times a second until something other than FINE is seen; return it and when."""
    now = start
    while now < end:
        verdict = watch.check(frozenset(present), over, now)
        if verdict is not Verdict.FINE:
            return verdict, now
        now += 0.25
    return Verdict.FINE, now


def test_a_server_that_is_there_may_be_silent_for_ever():
    assert looks(Liveness(frozenset({OLD})), {OLD}, end=100_000.0)[0] is Verdict.FINE


def test_a_server_that_is_gone_is_lost_after_the_grace():
    assert looks(Liveness(frozenset({OLD})), set()) == (Verdict.LOST, GRACE)


def test_what_keeps_its_goals_over_its_death_has_longer_to_be_back():
    watch = Liveness(frozenset({OLD}), grace=GRACE + 10.0)
    assert looks(watch, set(), end=GRACE + 9.0)[0] is Verdict.FINE
    watch.processes |= {NEW}  # its status says that it is at work on the goal
    assert watch.check(frozenset({NEW}), False, GRACE + 9.5) is Verdict.ASK
    assert looks(watch, set(), start=100.0, end=200.0) == (Verdict.LOST, 110.0 + GRACE)


def test_a_server_that_comes_back_is_asked_for_the_result():
    watch = Liveness(frozenset({OLD}))
    assert watch.check(frozenset(), False, 0.0) is Verdict.FINE
    assert watch.check(frozenset({OLD}), False, GRACE - 0.5) is Verdict.ASK
    assert looks(watch, {OLD}, start=GRACE)[0] is Verdict.FINE


@pytest.mark.parametrize("present", [{OLD, NEW}, {NEW}])
def test_a_new_process_is_asked_at_once_and_again_but_not_for_ever(present):
    watch = Liveness(frozenset({OLD}))
    assert looks(watch, present) == (Verdict.ASK, 0.0)
    assert looks(watch, present, start=0.25) == (Verdict.ASK, AGAIN)
    now, asks = AGAIN, 2
    while (found := looks(watch, present, start=now + 0.25))[0] is Verdict.ASK:
        now, asks = found[1], asks + 1
    assert asks <= ASKS
    assert found[0] is (Verdict.FINE if OLD in present else Verdict.LOST)


def test_each_process_that_comes_back_is_asked():
    watch = Liveness(frozenset({OLD}), grace=1000.0)
    now = 0.0
    for process in (b"second", b"third"):  # the second dies before it answers
        end, asks = now + 100.0, 0
        while now < end:
            verdict, now = looks(watch, {process}, start=now + 0.25, end=end)
            asks += verdict is Verdict.ASK
        assert asks == PATIENT_ASKS


def test_the_remains_of_an_older_process_may_leave_the_graph():
    watch = Liveness(frozenset({OLD, NEW}))
    assert looks(watch, {NEW})[0] is Verdict.FINE


def test_a_publisher_that_was_not_discovered_yet_is_taken_on():
    watch = Liveness(frozenset())
    assert watch.check(frozenset(), False, 0.0) is Verdict.FINE
    assert looks(watch, {OLD}, start=0.25)[0] is Verdict.ASK
    assert looks(watch, {OLD}, start=0.5)[0] is Verdict.FINE
    assert looks(watch, set(), start=5.0) == (Verdict.LOST, 5.0 + GRACE)


def test_a_result_that_does_not_come_is_asked_for_and_given_up():
    watch = Liveness(frozenset({OLD}))
    assert looks(watch, {OLD}, over=True) == (Verdict.ASK, AGAIN)
    asks, now = 1, AGAIN
    while (found := looks(watch, {OLD}, over=True, start=now + 0.25))[0] is Verdict.ASK:
        asks, now = asks + 1, found[1]
    assert (asks, found) == (ASKS, (Verdict.SILENT, AGAIN * (ASKS + 1)))


# --- feedback ---


def pose(x: float) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.position.x = x
    return message


@pytest.mark.parametrize(
    ("message", "line"),
    [
        (GroundAction.Feedback(progress=0.25), "progress 0.25"),
        (Fibonacci.Feedback(sequence=[0, 1, 1]), "sequence [0, 1, 1]"),
        (Fibonacci.Feedback(sequence=range(1000)), "sequence 1000 items"),
        (Fibonacci.Feedback(), ""),
        (
            RunPlan.Feedback(running=["move(r1)"], feedback=["progress 1"], ended=3),
            "running [move(r1)], feedback [progress 1], ended 3, restarts 0",
        ),
        (NestedMessage.Feedback(nested_different_pkg=Duration(sec=3, nanosec=250_000_000)), "nested_different_pkg 3.2 s"),
        (pose(1.23456), "pose.position.x 1.235, pose.position.y 0, pose.position.z 0"),
        (PolygonStamped(), ""),
        (Nested(basic_types_value=BasicTypes(byte_value=b"\x05")), "basic_types_value.bool_value false, basic_types_value.byte_value 5"),
    ],
)
def test_feedback_on_one_line(message, line):
    written = feedback_line(message)
    assert written.startswith(line), written
    assert bool(written) == bool(line)
    assert len(written) <= LENGTH + 3


def test_the_longest_line_ends_where_it_is_too_long():
    assert feedback_line(Arrays()).endswith(", …")
    assert feedback_line(RunPlan.Feedback(running=["x" * 1000])) == f"running [{'x' * (LENGTH - 10)}…"
