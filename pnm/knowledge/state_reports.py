"""What becomes of complete reports about predicates and functions, and of what is no longer reported.

Notices that something has not been heard of for too long.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from itertools import product
from math import prod
from typing import Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.declared_names import FluentKind, Signature
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, Unknown, Value, absent_value


class Watchdog:
    """Calls a function once nothing was heard for so many seconds, and again after every later silence.

    The mutable state is when something was heard last, and the one timer.

    Args:
        limit: seconds on the clock of the event loop; None for ever.
        fallen: what is called.
    """

    def __init__(self, limit: float | None, fallen: Callable[[], object]) -> None:
        self._loop = asyncio.get_running_loop()
        self._limit = limit
        self._fallen = fallen
        self._timer: asyncio.TimerHandle | None = None
        self.heard()

    def heard(self) -> None:
        """Note that something was heard, and begin to wait for more."""
        if self._limit is not None:
            self._until = self._loop.time() + self._limit
            self._timer = self._timer or self._loop.call_at(self._until, self._look)

    def close(self) -> None:
        """Wait no longer."""
        self._limit = None
        if self._timer is not None:
            self._timer.cancel()

    def _look(self) -> None:
        if self._loop.time() < self._until:  # one timer a silence, not one a message
            self._timer = self._loop.call_at(self._until, self._look)
        else:
            self._timer = None
            self._fallen()


MAX_INSTANCES: Final = 10_000
"""Fluents of one name that are made unknown when it is no longer reported; of more, only those that were so."""
_NOTHING: Final[Mapping[FluentKind, Value | Unknown]] = {FluentKind.FACT: False, FluentKind.OBJECT: UNDEFINED, FluentKind.NUMBER: UNKNOWN}

_log = logging.getLogger(__name__)


class StateReports:
    """Records reports that are complete about the names they give, and forgets names that fall silent.

    The mutable state is the silence of every name reported so far, what those that have fallen silent had before, and
    what was warned of.

    Args:
        knowledge: where they are recorded.
        ignored: for names whose reports are not recorded, why; empty if that goes without saying.
        lag: seconds that reports may be late.
        stale: seconds without a report after which nothing is known of a name; None for never.
        signatures: of the names, as far as they are known.
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
        self._silences: dict[str, Watchdog] = {}
        self._before: dict[str, dict[Fluent, Value | Unknown]] = {}

    def tell(self, names: Collection[str], facts: Mapping[Fluent, Value | Unknown], _sequence: int = 0) -> None:
        """Record a report."""
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
            if name in self._silences:
                self._silences[name].heard()
            else:
                self._silences[name] = Watchdog(self._stale, partial(self._forget, name))

    def close(self) -> None:
        """Forget nothing more."""
        for silence in self._silences.values():
            silence.close()

    def _forget(self, name: str) -> None:
        _log.warning("nothing was reported about %s for %g s; it is unknown now", name, self._stale)
        recorded = {fluent: absent_value(value) for fluent, value in self._knowledge.facts().items() if fluent[0] == name}
        self._before[name] = {**dict(self._instances(name)), **recorded}
        self._knowledge.update(dict.fromkeys(self._before[name], UNKNOWN))

    def _instances(self, name: str) -> Iterator[tuple[Fluent, Value | Unknown]]:
        if name in self._signatures:
            signature = self._signatures[name]
            objects = [self._knowledge.objects(types) for types in signature.parameters]
            if prod(map(len, objects)) <= MAX_INSTANCES:
                for arguments in product(*objects):
                    yield (name, *arguments), _NOTHING[signature.kind]
