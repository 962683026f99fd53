"""One sensor: its messages are checked, interpreted and recorded as facts, which become unknown when it falls silent."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.expressions import fluent_text
from pnm.core.message_fields import Look
from pnm.errors import InputError
from pnm.knowledge.sensor_model import ByService, Instance, Reading, read, unknown
from pnm.knowledge.state_reports import StalenessWatchdog
from pnm.ros.node.messages import FieldError, import_type, to_message
from pnm.ros.sensors.fitted import fitted

_log = logging.getLogger(__name__)


class SensorRecorder:
    """Records what one sensor, for one choice of objects, reports.

    The mutable state is the instance, whose constants are resolved once its type is known, its watchdog, the statements that
    the last message did not fit, why the sensor cannot be used, whether all sensors are open, whether it has fallen silent, and whether it
    is closed.
    """

    def __init__(self, instance: Instance, knowledge: KnowledgeBase) -> None:
        self.instance = instance
        self.heard = asyncio.Event()
        self.refused: InputError | None = None
        self.is_open = False
        self.is_stale = False
        self.loop = asyncio.get_running_loop()
        self._knowledge = knowledge
        self._unread: frozenset[int] = frozenset()
        self._closed = False
        self._watchdog = StalenessWatchdog(instance.sensor.stale, self._forget)

    def record(self, look: Look) -> None:
        """Record the facts and variables of a message, given how to read its fields."""
        if self._closed:
            return
        reading = read(self.instance, look, self._knowledge.objects)
        for number, reason in reading.unread.items():
            if number not in self._unread:
                statement = self.instance.sensor.statements[number]
                fluent = statement.name if hasattr(statement, "name") else fluent_text(statement.fluent)
                _log.warning("%s: %s; %s is unknown", self.instance.name, reason, fluent)
        self._unread = frozenset(reading.unread)
        self._store(reading)
        self.is_stale = False
        self._watchdog.reset()
        if isinstance(self.instance.sensor.way, ByService):
            self._watchdog.rest()
        self.heard.set()

    def expect(self) -> None:
        """Note that an answer is expected from now on; topics are always expected to say something."""
        if not self._closed:
            self._watchdog.expect()

    def refuse(self, error: InputError) -> None:
        """Note that the sensor cannot be used: what it reports is unknown. While sensors are opened, this is raised, not logged."""
        if self.refused is None:
            if self.is_open:
                _log.error("%s", error)
            self.refused = error
            self._watchdog.close()
            self._knowledge.forget((refused := self._unknown()).facts, str(error))
            self._store(refused)
            self.heard.set()

    def close(self) -> None:
        """Record nothing more."""
        self._closed = True
        self._watchdog.close()

    def _forget(self) -> None:
        self.is_stale = True
        why, silent = f"nothing was heard on {self.instance.name} for {self.instance.sensor.stale:g} s", self._unknown()
        _log.warning("%s; what it reports is unknown", why)
        self._knowledge.forget(silent.facts, why)
        self._store(silent)

    def _unknown(self) -> Reading:
        return unknown(self.instance, self._knowledge.objects)

    def _store(self, reading: Reading) -> None:
        self._knowledge.update(reading.facts)
        known = {name: self._knowledge.variable(name) for name in reading.variables}
        changed = {name: value for name, value in reading.variables.items() if value != (None if known[name] is MISSING else known[name])}
        if changed:
            self._knowledge.store(changed)


@dataclass(frozen=True, slots=True)
class SensorUse:
    """How one sensor is doing."""

    instance: Instance
    name: str
    """The full name of its topic or service."""
    is_heard: bool
    refused: InputError | None
    """Why it cannot be used."""
    is_stale: bool = False
    """Whether it has fallen silent."""


def checked(instance: Instance, name: str) -> tuple[Any, Instance]:
    """Return the type, and the sensor with the values of its constants; raise an `InputError` if the type does not fit it."""
    sensor = instance.sensor
    try:
        kind = import_type(name)
        if isinstance(sensor.way, ByService):
            to_message(kind.Request, instance.request(sensor.way))
    except (InputError, FieldError) as error:
        raise InputError(str(error), sensor.position) from error
    return kind, replace(instance, sensor=fitted(sensor, kind.Response if isinstance(sensor.way, ByService) else kind))


def resolved(resolve: Callable[[str], object], instance: Instance, what: str) -> str:
    """Return the full name of the sensor's topic or service; raise an `InputError` if it is not valid in ROS."""
    try:
        return str(resolve(instance.name))
    except Exception as error:
        reason = (str(error).strip().splitlines() or [repr(error)])[0]
        raise InputError(f"not a name for a {what}: {instance.name!r} ({reason})", instance.sensor.position) from error
