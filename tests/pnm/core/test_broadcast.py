"""Every moment of a class of listeners is passed on to all listeners; a new one cannot be forgotten."""

from __future__ import annotations

from inspect import signature
from typing import Any
from uuid import UUID

import pytest

from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.events import Observer, broadcast
from pnm.tasks import TaskListener


def recorder(kind: type[Any], record: list[tuple[str, tuple[object, ...]]]) -> Any:
    """A listener that records every public method that is called."""

    def recording(moment: str) -> Any:
        return lambda self, *arguments: record.append((moment, arguments))

    return type("Recorder", (kind,), {moment: recording(moment) for moment in dir(kind) if not moment.startswith("_")})()


class WithNewMoment(TaskObserver):
    def invented(self, what: str) -> None:
        """Note something that no listener in this project knows of."""


@pytest.mark.parametrize("kind", [Observer, TaskObserver, TaskListener, WithNewMoment])
def test_every_moment_is_delivered_to_every_listener_in_their_order(kind: type[Any]) -> None:
    records: list[tuple[str, tuple[object, ...]]] = []
    others: list[tuple[str, tuple[object, ...]]] = []
    listeners = [recorder(kind, records)]
    everyone = broadcast(kind, listeners)
    assert isinstance(everyone, kind)
    listeners.append(recorder(kind, others))
    moments = {name: getattr(kind, name) for name in dir(kind) if not name.startswith("_")}
    assert moments
    expected = []
    for moment, method in moments.items():
        arguments = tuple(object() for _ in list(signature(method).parameters)[1:])
        getattr(everyone, moment)(*arguments)
        expected.append((moment, arguments))
    assert records == others == expected
    listeners.pop()
    getattr(everyone, expected[0][0])(*expected[0][1])
    assert (len(records), len(others)) == (len(expected) + 1, len(expected))


def test_a_listener_that_leaves_while_it_is_called_leaves_the_others_in_peace() -> None:
    heard: list[str] = []
    listeners: list[TaskListener] = []

    class Leaves(TaskListener):
        def changed(self, task: object) -> None:
            heard.append("leaves")
            listeners.remove(self)

    class Stays(TaskListener):
        def changed(self, task: object) -> None:
            heard.append("stays")

    listeners += [Leaves(), Stays()]
    everyone: Any = broadcast(TaskListener, listeners)
    everyone.changed(1)
    everyone.changed(1)
    assert heard == ["leaves", "stays", "stays"]


def test_a_moment_that_one_listener_hears_goes_to_it_directly() -> None:
    class Hears(TaskListener):
        def changed(self, task: object) -> None:
            """Hear it."""

    hears, deaf = Hears(), TaskListener()
    everyone = broadcast(TaskListener, (deaf, hears))
    assert everyone.changed == hears.changed
    late: list[object] = []
    deaf.changed = late.append  # type: ignore[method-assign, assignment]
    broadcast(TaskListener, (deaf, hears)).changed(UUID(int=1))
    assert late == [UUID(int=1)]
