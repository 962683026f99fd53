"""State reports → knowledge: complete reports about predicates and functions are recorded, and names become unknown when stale.

What cannot be so, because it does not fit the domain or cannot be read, makes the names of the report unknown: there is a sensor for
them, so nothing about them is assumed, but what it sees is not known.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from math import prod
from typing import Final

from pnm.core.knowledge_base import KnowledgeBase, statement_text
from pnm.core.logic.domain import FluentKind, Vocabulary
from pnm.core.logic.expressions import EXISTS, UNDEFINED, UNKNOWN, Fluent, Unknown, Value, absent_value
from pnm.core.readiness import Readiness, ReadyState
from pnm.errors import InputError, suggestion


class StalenessWatchdog:
    """A staleness watchdog: calls a function when it was not reset for `limit` seconds, and again after every later reset.

    The limit is on the clock of the event loop; None for none. Its state: the time of expiry, the one timer, and whether it rests.
    """

    def __init__(self, limit: float | None, expired: Callable[[], object]) -> None:
        self._loop = asyncio.get_running_loop()
        self._limit = limit
        self._expired = expired
        self._timer: asyncio.TimerHandle | None = None
        self._rests = False
        self.reset()

    def reset(self) -> None:
        """Restart the wait: a report has come."""
        if self._limit is not None:
            self._until = self._loop.time() + self._limit
            self._timer = self._timer or self._loop.call_at(self._until, self._check)

    def expect(self) -> None:
        """Start the wait again after a rest: a report is expected from now on."""
        if self._rests:
            self._rests = False
            self.reset()

    def rest(self) -> None:
        """End the wait: no report is expected until `expect`."""
        self._rests = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def close(self) -> None:
        """End the wait for good."""
        self._limit = None
        self.rest()

    def _check(self) -> None:
        if self._loop.time() < self._until:  # a report does not move the timer: that would cost one timer per message
            self._timer = self._loop.call_at(self._until, self._check)
        else:
            self._timer = None
            self._expired()


MAX_INSTANCES: Final = 10_000
"""Fluents of one name that become unknown when it is stale; if there are more, only the recorded ones do."""
RETURNS: Final = 3
"""The number of steps back in the count of reports before they count as those of several senders."""
_ABSENT: Final[Mapping[FluentKind, Value | Unknown]] = {FluentKind.FACT: False, FluentKind.OBJECT: UNDEFINED, FluentKind.NUMBER: UNKNOWN}
_log = logging.getLogger(__name__)


@dataclass(eq=False, repr=False)
class StateReports:
    """Records reports that are complete about the names they give, and makes names unknown that become stale or are reported wrongly.

    The mutable state is what is declared, and all private fields.
    """

    knowledge: KnowledgeBase
    """It records the reports."""
    ignored: Mapping[str, str]
    """Names whose reports are not recorded, with the reason for a warning; empty for no warning."""
    lag: float
    """Seconds that reports may be late."""
    stale: float | None = None
    """Seconds without a report after which a name becomes unknown; None for never."""
    known: Vocabulary | None = None
    """The declared names, which reports are checked against; None if nothing is declared."""
    source: str = "the state topic"
    """The name by which people know the source of the reports."""
    _warned: set[str] = field(default_factory=set)
    _right: dict[Fluent, Value | Unknown] = field(default_factory=dict)
    """Statements that were found to be right."""
    _watchdogs: dict[str, StalenessWatchdog] = field(default_factory=dict)
    _before: dict[str, dict[Fluent, Value | Unknown]] = field(default_factory=dict)
    """The values that unknown names had before."""
    _senders: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Of every name its last count of reports, and how often that went back."""

    def __post_init__(self) -> None:
        self._complaints = Complaints(self.source)

    def declare(self, known: Vocabulary | None) -> None:
        """Check reports against these names from now on."""
        self.known, self._right = known, {}

    def record(self, names: Collection[str], facts: Mapping[Fluent, Value | Unknown], sequence: int = 0) -> None:
        """Record a report that is complete about the names; those of which it says what cannot be so become unknown."""
        if self.known is not None and (EXISTS in names or len(self.knowledge.objects(("object",))) > len(self.known.objects)):
            found = {**self.knowledge.found(), **KnowledgeBase(facts).found()}
            if not found.keys() <= self.known.objects:
                self.declare(self.known.with_objects(found))
        wrong = self._wrong(names, facts)
        if wrong:
            self._complaints.note(next(iter(wrong.values())))
        watched = self._watched(names) - wrong.keys()
        self.knowledge.sense(watched, lag=self.lag)
        returned = {fluent: value for name in watched for fluent, value in self._before.pop(name, {}).items()}
        reported = {fluent: value for fluent, value in facts.items() if fluent[0] in watched}
        changed = {fluent[0] for fluent in self.knowledge.replace(watched, {**returned, **reported})}
        for name in watched:
            last, returns = self._senders.get(name, (0, 0))
            if name in changed and 1 < sequence <= last:  # each sender counts its reports, and one that is restarted begins with 1
                returns += 1
                if returns >= RETURNS:
                    self._complaints.note(f"several senders contradict each other about {name}; expected names of its own from each")
            self._senders[name] = sequence, returns
            if name in self._watchdogs:
                self._watchdogs[name].reset()
            else:
                silence = f"nothing was reported about {name} for {self.stale:g} s" if self.stale else ""
                self._watchdogs[name] = StalenessWatchdog(self.stale, partial(self._forget, name, silence))
        self._distrust(self._watched(names) & wrong.keys())

    def readiness(self, topic: str, kinds: Collection[str]) -> tuple[Readiness, ...]:
        """Return the readiness of the topic of these reports, once it was heard; its publishers have these types."""
        heard = ", ".join(sorted(self._watchdogs.keys() | self._before.keys()))
        row = Readiness(heard, topic, ", ".join(kinds), ReadyState.STALE, is_sensor=True)
        if self._before:
            return (replace(row, advice=f"nothing right was reported about {', '.join(sorted(self._before))} of late; it is unknown"),)
        if heard and not kinds:
            return (replace(row, advice=f"nothing reports about {heard} any more; the last report is believed"),)
        return (replace(row, state=ReadyState.READY),) if heard else ()

    def refuse(self, names: Collection[str], reason: str) -> None:
        """Refuse a report about these names that cannot be read: they become unknown."""
        self._complaints.note(reason)
        self._distrust(self._watched(names))

    def _watched(self, names: Collection[str]) -> frozenset[str]:
        """Return the names that are recorded; there is a warning about those that are not."""
        for name in sorted(set(names) & self.ignored.keys()):
            if self.ignored[name] and name not in self._warned:
                _log.warning("reports about %s are ignored: %s", name, self.ignored[name])
                self._warned.add(name)
        return frozenset(name for name in names if self.known is None or self.known.may_be_reported(name)) - self.ignored.keys()

    def _wrong(self, names: Collection[str], facts: Mapping[Fluent, Value | Unknown]) -> dict[str, str]:
        """Return the names of which the report says what cannot be so, with the reasons."""
        wrong: dict[str, str] = {}
        if self.known is not None:
            for name in sorted(name for name in names if not (self.known.may_be_reported(name) or name in self.ignored)):
                wrong[name] = f"{name} is not declared; {suggestion(name, self.known.fluents) or 'nothing it says of that is recorded'}"
        for fluent, value in facts.items():
            name, is_number = fluent[0], not isinstance(value, bool | str)
            if name in wrong or name in self.ignored:
                continue
            if name not in names:  # then it is not known what it is about
                reason = f"it says {statement_text(fluent, value)}, but does not name {name} among the names that it covers"
                wrong |= {name: reason, **dict.fromkeys(names, reason)}
            elif self.known is not None and (is_number or self._right.get(fluent) != value):
                try:
                    self.known.check_report(fluent, value)
                except InputError as error:
                    wrong[name] = error.message
                else:
                    if not is_number:  # which are new every time
                        self._right[fluent] = value
        return wrong

    def close(self) -> None:
        """Cancel the watchdogs, and log the complaints that are left."""
        for watchdog in self._watchdogs.values():
            watchdog.close()
        self._complaints.close()

    def _distrust(self, names: Collection[str]) -> None:
        """Note that there is a sensor for the names, and that what it sees is not known."""
        self.knowledge.sense(names, lag=self.lag)
        for name in names:
            if name not in self._before:
                self._forget(name)

    def _forget(self, name: str, silence: str = "") -> None:
        if silence:
            _log.warning("%s; it is unknown now", silence)
        before: dict[Fluent, Value | Unknown] = {}
        signature = self.known.signatures.get(name) if self.known else None
        if signature is not None:
            objects = [self.knowledge.objects(types) for types in signature.parameters]
            if prod(map(len, objects)) <= MAX_INSTANCES:
                before = {(name, *arguments): _ABSENT[signature.kind] for arguments in product(*objects)}
        before |= {fluent: absent_value(value) for fluent, value in self.knowledge.facts().items() if fluent[0] == name}
        self._before[name] = before
        self.knowledge.forget(before, silence)


# --- complaints: the first is logged at once, those that follow as a number ----------------

PERIOD: Final = 60.0
"""Seconds between two lines of the log about the same source."""


class Complaints:
    """Complaints about one source of reports, by the name that people know it by, on the event loop's thread.

    The mutable state is how many complaints have not been logged yet, the last one, and the timer of the next line.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._count = 0
        self._last = ""
        self._timer: asyncio.TimerHandle | None = None

    def note(self, reason: str) -> None:
        """Log why a report is wrong: now, or with others at the end of the period."""
        if self._timer is None:
            _log.warning("a report on %s is wrong: %s", self._source, reason)
            self._timer = asyncio.get_running_loop().call_later(PERIOD, self._end_period)
        else:
            self._count += 1
            self._last = reason

    def close(self) -> None:
        """Log what has not been logged yet."""
        if self._timer is not None:
            self._timer.cancel()
            self._summarize()

    def _end_period(self) -> None:
        # as long as there are complaints, periods follow each other, with one line each
        self._timer = asyncio.get_running_loop().call_later(PERIOD, self._end_period) if self._count else None
        self._summarize()

    def _summarize(self) -> None:
        if self._count:
            _log.warning("%d more reports on %s were wrong; the last one: %s", self._count, self._source, self._last)
            self._count = 0
