"""State reports → knowledge: complete reports about predicates and functions are recorded, and names become unknown when stale."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Mapping
from functools import partial
from itertools import product
from math import prod
from typing import Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.declared_names import FluentKind, Signature
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, Unknown, Value, absent_value


class Watchdog:
    """A staleness watchdog: calls a function when it was not reset for `limit` seconds, and again after every later reset.

    The limit is on the clock of the event loop; None for none. The mutable state is the time of expiry and the one timer.
    """

    def __init__(self, limit: float | None, expired: Callable[[], object]) -> None:
        self._loop = asyncio.get_running_loop()
        self._limit = limit
        self._expired = expired
        self._timer: asyncio.TimerHandle | None = None
        self.reset()

    def reset(self) -> None:
        """Restart the wait: a report has come."""
        if self._limit is not None:
            self._until = self._loop.time() + self._limit
            self._timer = self._timer or self._loop.call_at(self._until, self._check)

    def close(self) -> None:
        """Cancel the timer."""
        self._limit = None
        if self._timer is not None:
            self._timer.cancel()

    def _check(self) -> None:
        if self._loop.time() < self._until:  # a report does not move the timer: that would cost one timer per message
            self._timer = self._loop.call_at(self._until, self._check)
        else:
            self._timer = None
            self._expired()


MAX_INSTANCES: Final = 10_000
"""Fluents of one name that become unknown when it is stale; if there are more, only the recorded ones do."""
_ABSENT: Final[Mapping[FluentKind, Value | Unknown]] = {FluentKind.FACT: False, FluentKind.OBJECT: UNDEFINED, FluentKind.NUMBER: UNKNOWN}

_log = logging.getLogger(__name__)


class StateReports:
    """Records reports that are complete about the names they give, and makes names unknown that become stale.

    The mutable state is the watchdog of every name reported so far, the values that stale names had before, and
    the warnings given.

    Args:
        knowledge: records the reports.
        ignored: names whose reports are not recorded, with the reason for a warning; empty for no warning.
        lag: seconds that reports may be late.
        stale: seconds without a report after which a name becomes unknown; None for never.
        signatures: the known signatures of the names.
    """

    def __init__(
        self,
        knowledge: KnowledgeBase,
        ignored: Mapping[str, str],
        lag: float,
        stale: float | None = None,
        signatures: Mapping[str, Signature] | None = None,
    ) -> None:
        self._knowledge = knowledge
        self._ignored = dict(ignored)
        self._lag = lag
        self._stale = stale
        self._signatures = signatures or {}
        self._watchdogs: dict[str, Watchdog] = {}
        self._before: dict[str, dict[Fluent, Value | Unknown]] = {}

    def record(self, names: Collection[str], facts: Mapping[Fluent, Value | Unknown], _sequence: int = 0) -> None:
        """Record a report that is complete about the names."""
        for name in sorted(set(names) & self._ignored.keys()):
            if self._ignored[name]:
                _log.warning("reports about %s are ignored: %s", name, self._ignored[name])
                self._ignored[name] = ""
        watched = set(names) - self._ignored.keys()
        self._knowledge.sense(watched, lag=self._lag)
        returned = {fluent: value for name in watched for fluent, value in self._before.pop(name, {}).items()}
        reported = {fluent: value for fluent, value in facts.items() if fluent[0] in watched}
        self._knowledge.replace(watched, {**returned, **reported})
        for name in watched:
            if name in self._watchdogs:
                self._watchdogs[name].reset()
            else:
                self._watchdogs[name] = Watchdog(self._stale, partial(self._forget, name))

    def close(self) -> None:
        """Cancel the watchdogs."""
        for watchdog in self._watchdogs.values():
            watchdog.close()

    def _forget(self, name: str) -> None:
        _log.warning("nothing was reported about %s for %g s; it is unknown now", name, self._stale)
        before: dict[Fluent, Value | Unknown] = {}
        if name in self._signatures:
            signature = self._signatures[name]
            objects = [self._knowledge.objects(types) for types in signature.parameters]
            if prod(map(len, objects)) <= MAX_INSTANCES:
                before = {(name, *arguments): _ABSENT[signature.kind] for arguments in product(*objects)}
        before |= {fluent: absent_value(value) for fluent, value in self._knowledge.facts().items() if fluent[0] == name}
        self._before[name] = before
        self._knowledge.update(dict.fromkeys(before, UNKNOWN))
