"""Rates: how often attempts at calls end in which way, with which outcome, and after how many seconds; learned, and kept as YAML.

All that is kept are counts of whole numbers, so that two files add up to just what one file of both would be. Seconds are counted in
steps of 2 %, beside their sum: means are exact, and quantiles within 2 % of what was measured. The rates of an action, of its server
and of its first arguments are sums of those of its calls.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from functools import cached_property
from math import exp, log, sqrt
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from planner_bridge.model.plan import ASSUMED_SECONDS
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import Alternative
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError, Position
from pnm.files.text import write_private

if TYPE_CHECKING:
    from pnm.files.yaml_nodes import Mapped

K = TypeVar("K")

STEP: Final = 1.02
"""The ratio of neighbouring counted seconds."""
LEAST: Final = 0.001
"""The fewest counted seconds."""
MOST_CALLS: Final = 200
"""Calls of an action that are counted apart; those of more are counted by their first arguments, as many as keep to it."""
GONE: Final = "gone/"
"""Before the ids of journals that are no more: `MOST_GONE` of these are kept, the last by the alphabet, so that two files that have
counted the same ones still share some."""
MOST_GONE: Final = 100
ENOUGH: Final = 20
"""Attempts from which a call, its first arguments or its server have a chance of their own. What is known of more calls counts as
as many attempts."""
ENOUGH_TIMES: Final = 5
"""Measured times from which they have seconds of their own: those vary less than ends do."""
BEFORE: Final = 2
"""Measured times for which counts, in the mean of those of a call, what is known beside them."""
ENOUGH_FOR_LIMIT: Final = 10
"""Successful attempts from which there is a limit that fits."""
LEAST_LIMIT: Final = 1.0
"""The fewest seconds of a limit: messages may be late."""
FALSE_TIMEOUTS: Final = 0.001
"""The share of successful attempts that a limit that fits may cut off."""
SECURITY: Final = 0.95
"""The share of intervals that hold the true chance."""


class End(StrEnum):
    """The end of an attempt: the outcome of its request, or what the run has seen of it."""

    SUCCEEDED = "succeeded"
    EFFECTS_MISSING = "effects_missing"
    """Success was reported, and its effects were not observed."""
    ABORTED = "aborted"
    ABORTED_FOR_GOOD = "aborted_for_good"
    """For a reason that another attempt would meet again."""
    REJECTED = "rejected"
    TIMED_OUT = "timed_out"
    UNAVAILABLE = "unavailable"
    LOST = "lost"
    CANCELED = "canceled"
    """It was called off, which says nothing about the action: it is counted, and no part of any chance."""


ASSUMED: Final[Mapping[str, float]] = {End.SUCCEEDED: 0.9, End.ABORTED: 0.1}
"""Chances of which nothing is known; together they count as one attempt."""


_BARE: Final = re.compile(r'[^\s(),"\\]+')
_WORD: Final = rf'(?:{_BARE.pattern}|"(?:[^"\\]|\\.)*")'
_CALL: Final = re.compile(rf"\s*{_WORD}\s*\(\s*(?:{_WORD}(?:\s*,\s*{_WORD})*)?\s*\)\s*")


class Call(NamedTuple):
    """A call: the server, the action and its arguments, or the first of them for all calls that begin so."""

    server: str
    action: str
    arguments: tuple[str, ...] = ()

    @staticmethod
    def of(action: GroundAction, bindings: Bindings) -> Call:
        """Return the call of a ground action; one that waits for an argument to name its server has the action for it."""
        return Call(bindings.server(action) if bindings.names_server(action) else action.name, action.name, action.arguments)

    def __str__(self) -> str:
        first, *others = [
            word if _BARE.fullmatch(word) else json.dumps(word, ensure_ascii=False) for word in (self.action, *self.arguments)
        ]
        return f"{first}({', '.join(others)})"

    @property
    def group(self) -> tuple[str, ...]:
        """What it belongs to: the action, the server, and one argument after the other."""
        return (self.action, self.server, *self.arguments)


class Basis(Enum):
    """What a number rests on."""

    LEARNED = "learned"
    DECLARED = "declared"
    ASSUMED = "assumed"


@dataclass(frozen=True, slots=True)
class Rests:
    """What a number rests on: if it was learned, on how many attempts at which calls."""

    basis: Basis
    n: int = 0
    group: str = ""

    def __str__(self) -> str:
        return f"learned from {self.n} of {self.group}" if self.basis is Basis.LEARNED else self.basis.value


@dataclass(frozen=True, slots=True)
class Chance:
    """The chances of the ends of an attempt, or of the outcomes of a call, as a Dirichlet distribution.

    Args:
        weights: its parameters: attempts that have ended so, and what was assumed before; the chances themselves if they are declared.
    """

    weights: Mapping[str, float]
    rests: Rests

    def of(self, end: str) -> float:
        """Return the mean chance of an end, or of the outcome of a name."""
        return self.weights.get(end, 0.0) / sum(self.weights.values())

    @property
    def estimate(self) -> tuple[object, ...]:
        """What they rest on; where this is the same, they are."""
        return self.rests, *self.weights

    def drawn(self, random: Random, count: int = 1) -> list[Chance]:
        """Return them as they may be instead in so many worlds, if they were learned; see `as_may_be`."""
        if self.rests.basis is not Basis.LEARNED:
            return [self] * count
        drawn = as_may_be([self.of(end) for end in self.weights], sum(self.weights.values()), random, count)
        return [replace(self, weights=dict(zip(self.weights, shares, strict=True))) for shares in drawn]

    @property
    def success(self) -> float:
        """The mean chance of success."""
        return self.of(End.SUCCEEDED)

    def interval(self, security: float = SECURITY) -> tuple[float, float]:
        """Return the interval that holds the chance of success with this security."""
        return wilson(self.success, sum(self.weights.values()), security)


def as_may_be(chances: Sequence[float], total: float, random: Random, count: int = 1) -> list[list[float]]:
    """Return chances as they may be instead in so many worlds, if they were estimated from so many attempts.

    If there are many worlds, their mean is as it is: what rests on the draws is then hardly off by luck.
    """
    if not total:
        return [[*chances]] * count
    drawn = [[random.gammavariate(total * chance, 1.0) if chance else 0.0 for chance in chances] for _ in range(count)]
    shares = [[value / sum(values) for value in values] if any(values) else [*chances] for values in drawn]
    if count == 1:
        return shares
    sums = [sum(column) for column in zip(*shares, strict=True)]
    # what is hardly drawn at all is too small for a mean: it is none
    scales = [chance * count / drawn if drawn > chance else 0.0 for chance, drawn in zip(chances, sums, strict=True)]
    scaled = [[share * scale for share, scale in zip(values, scales, strict=True)] for values in shares]
    return [[share / sum(values) for share in values] for values in scaled]


@dataclass(frozen=True, slots=True)
class Durations:
    """Seconds that attempts take: those that were counted, the fewest first, how often, and their mean."""

    buckets: tuple[tuple[float, int], ...]
    mean: float
    rests: Rests

    def quantile(self, share: float) -> float:
        """Return the seconds within which this share of attempts ends."""
        left = share * sum(count for _, count in self.buckets)
        for seconds, count in self.buckets:
            left -= count
            if left <= 1e-9:
                return seconds
        return self.buckets[-1][0]


@dataclass(frozen=True, slots=True)
class Times:
    """Measured times: how often which step of seconds, and the sum of all in milliseconds."""

    steps: Mapping[int, int] = field(default_factory=dict)
    total: int = 0

    @staticmethod
    def of(seconds: float) -> Times:
        """Return one measured time."""
        return Times({step_of(seconds): 1}, round(seconds * 1000.0))

    def __add__(self, other: Times) -> Times:
        return Times(_plus(self.steps, other.steps), self.total + other.total) if other.steps else self

    @property
    def n(self) -> int:
        """Their number."""
        return sum(self.steps.values())

    def seconds(self, rests: Rests) -> Durations:
        """Return them as seconds, whose sum is what was measured; there must be some."""
        exact = self.total / 1000.0 / sum(STEP**step * count for step, count in self.steps.items())
        buckets = tuple([(STEP**step * exact, count) for step, count in sorted(self.steps.items())])
        return Durations(buckets, self.total / 1000.0 / self.n, rests)


def _plus(some: Mapping[K, int], more: Mapping[K, int]) -> dict[K, int]:
    return {**some, **{key: some.get(key, 0) + count for key, count in more.items()}}


def normal_quantile(share: float) -> float:
    """Return a quantile of the normal distribution."""
    from statistics import NormalDist  # here, because most commands need none

    return NormalDist().inv_cdf(share)


def wilson(share: float, n: float, security: float = SECURITY) -> tuple[float, float]:
    """Return the interval that holds a chance with this security, after a share of n trials (Wilson 1927)."""
    z = normal_quantile(0.5 + security / 2.0)
    centre, wide = share + z * z / (2.0 * n), z * sqrt(share * (1.0 - share) / n + z * z / (4.0 * n * n))
    return max(0.0, (centre - wide) / (1.0 + z * z / n)), min(1.0, (centre + wide) / (1.0 + z * z / n))


def step_of(seconds: float) -> int:
    """Return the step in which seconds are counted."""
    return round(log(max(seconds, LEAST)) / log(STEP))


@dataclass(frozen=True, slots=True)
class Counts:
    """How attempts have ended, and when: those that succeeded, and those that failed, from acceptance to the end.

    Args:
        outcomes: which of the outcomes of their action they had, where it has several and it is known.
    """

    ends: Mapping[End, int] = field(default_factory=dict)
    took: Times = field(default_factory=Times)
    failed_after: Times = field(default_factory=Times)
    outcomes: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def of(end: End, seconds: float | None, outcome: str = "") -> Counts:
        """Return one attempt; no seconds if it was not seen to take any time."""
        took = Times() if seconds is None or end is End.CANCELED else Times.of(seconds)
        if end is End.SUCCEEDED:
            return Counts({end: 1}, took, outcomes={outcome: 1} if outcome else {})
        return Counts({end: 1}, failed_after=took)

    def __add__(self, other: Counts) -> Counts:
        outcomes = _plus(self.outcomes, other.outcomes)
        return Counts(_plus(self.ends, other.ends), self.took + other.took, self.failed_after + other.failed_after, outcomes)

    @property
    def tries(self) -> Mapping[str, int]:
        """The ends that an attempt comes to by itself, and how often."""
        return {end: self.ends[end] for end in End if end in self.ends and end is not End.CANCELED}

    @property
    def n(self) -> int:
        """How many they are."""
        return sum(self.tries.values())


@dataclass(frozen=True)
class Rates:
    """Rates, by call, and the journals that they were learned from: for the id of each its last record that was counted."""

    calls: Mapping[Call, Counts] = field(default_factory=dict)
    journals: Mapping[str, int] = field(default_factory=dict)

    # --- counting ---

    def grown(self, journal: str, last: int, attempts: Iterable[tuple[Call, Counts]]) -> Rates:
        """Return them with the attempts of a journal, up to and with a record."""
        journals = {**self.journals, journal: last}
        for id in sorted(id for id in journals if id.startswith(GONE))[:-MOST_GONE]:
            del journals[id]
        return Rates(_summed((*self.calls.items(), *attempts)), journals)

    def merge(self, other: Rates) -> Rates:
        """Return the rates of both; if all that one has counted is in the other, that one.

        Raises:
            InputError: each has counted what the other has not, and some journal is in both: its attempts would count twice.
        """
        for more, less in ((self, other), (other, self)):
            if less.journals and all(more.journals.get(id, -1) >= last for id, last in less.journals.items()):
                return more
        if both := sorted(self.journals.keys() & other.journals.keys()):
            raise InputError(
                f"both have counted the journal {both[0]}, and each another one; expected rates learned from all of them at once"
            )
        return Rates(_summed((*self.calls.items(), *other.calls.items())), {**self.journals, **other.journals})

    # --- looking up ---

    @cached_property
    def groups(self) -> Mapping[tuple[str, ...], Counts]:
        """The sums of all calls that begin alike: of an action, of its server, and so on."""
        return _sums(((call.group[:length], counts) for call, counts in self.calls.items() for length in range(1, len(call.group) + 1)))

    def _known(self, call: Call) -> Iterator[tuple[str, Counts]]:
        """Yield the counts of the groups that a call belongs to, the widest first, each in words and with more to it than the next."""
        group, before = call.group, None
        for length in range(1, len(group) + 1):
            counts = self.groups.get(group[:length])
            if counts is None:
                return
            if counts != before:
                server = f" by {call.server}" if length == 2 else ""
                more = ", …" if length < len(group) else ""
                yield call.action + (f"({', '.join(group[2:length])}{more})" if length > 2 else server), counts
            before = counts

    def chance(self, call: Call) -> Chance:
        """Return the chances of the ends of an attempt at a call.

        They are those of the action. Where its server, or its first arguments, or all of them, have had enough attempts, these count
        beside what is known of the wider group.
        """
        return self._chance(call, ASSUMED, lambda counts: counts.tries)

    def outcomes(self, call: Call, ways: Sequence[Alternative]) -> Chance:
        """Return the chances of the outcomes of a call: as they are declared; else learned, as in `chance`; else all are as likely.

        Before anything is learned, they count as one attempt together.
        """
        declared = {way.name: way.chance for way in ways if way.chance is not None}
        if declared:
            return Chance(declared, Rests(Basis.DECLARED))
        even = dict.fromkeys([way.name for way in ways], 1.0 / len(ways))
        return self._chance(call, even, lambda counts: {name: counts.outcomes[name] for name in even if name in counts.outcomes})

    def _chance(self, call: Call, before: Mapping[str, float], counted: Callable[[Counts], Mapping[str, int]]) -> Chance:
        weights, rests = before, Rests(Basis.ASSUMED)
        for group, counts in self._known(call):
            seen = counted(counts)
            if (n := sum(seen.values())) >= (ENOUGH if rests.n else 1):
                share = ENOUGH / sum(weights.values()) if rests.n else 1.0
                weights = {end: share * weights.get(end, 0.0) + seen.get(end, 0) for end in {**weights, **seen}}
                rests = Rests(Basis.LEARNED, n, group)
        return Chance(weights, rests)

    def seconds(self, call: Call, declared: float | None = None, *, succeeded: bool = True) -> Durations:
        """Return the seconds of an attempt at a call that succeeds, or that does not.

        They are those of the nearest group that has enough of them; else they are as declared; else of the action, however few; else
        assumed.
        """
        known = [(group, counts.took if succeeded else counts.failed_after) for group, counts in self._known(call)]
        enough = [(group, times) for group, times in known if times.n >= ENOUGH_TIMES]
        if enough or (declared is None and known and known[0][1].n):
            group, times = enough[-1] if enough else known[0]
            return times.seconds(Rests(Basis.LEARNED, times.n, group))
        if not succeeded:
            return self.seconds(call, declared)
        seconds = ASSUMED_SECONDS if declared is None else declared
        return Durations(((seconds, 1),), seconds, Rests(Basis.ASSUMED if declared is None else Basis.DECLARED))

    def mean(self, call: Call, declared: float | None = None, *, succeeded: bool = True) -> float:
        """Return the expected seconds of an attempt at a call that succeeds, or that does not; few measured times move them a little.

        What is declared, or known of a wider group, counts as `BEFORE` measured times.
        """
        known = declared if succeeded else self.mean(call, declared)
        for _, counts in self._known(call):
            if (times := counts.took if succeeded else counts.failed_after).n:
                before = 0 if known is None else BEFORE
                known = (times.total / 1000.0 + before * (known or 0.0)) / (times.n + before)
        return ASSUMED_SECONDS if known is None else known

    def limit(self, call: Call) -> float | None:
        """Return a limit, in seconds, that cuts off one successful attempt of a thousand at most; None if there were too few.

        It is a bound for the next attempt if logarithms of seconds have a normal distribution, and more than the longest one was.
        """
        fitting = [counts.took for _, counts in self._known(call) if counts.took.n >= ENOUGH_FOR_LIMIT]
        if not fitting:
            return None
        steps, n = fitting[-1].steps, fitting[-1].n
        mean = sum(step * count for step, count in steps.items()) / n
        spread = sqrt(sum((step - mean) ** 2 * count for step, count in steps.items()) / (n - 1) * (1.0 + 1.0 / n))
        z, v = normal_quantile(1.0 - FALSE_TIMEOUTS / 2.0), n - 1  # by half, for what is not just normal
        # the quantile of Student's distribution, by Cornish and Fisher
        t = z + (z**3 + z) / (4 * v) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * v**2)
        t += (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * v**3)
        return max(exp(log(STEP) * (mean + t * spread)), 1.25 * exp(log(STEP) * max(steps)), LEAST_LIMIT)

    def limiting(self, bindings: Bindings, actions: Mapping[str, ActionSchema]) -> Bindings:
        """Return bindings with the limits that fit, for actions whose own binding says none.

        An action whose duration depends on its arguments keeps the usual limit, which goes with its duration.
        """
        fixed = (name for name, schema in actions.items() if all(isinstance(one.bound, Constant) for one in schema.duration or ()))
        limits = {name: self.limit(Call("", name)) for name in fixed if bindings.of(name).timeout is None}
        timed = {name: replace(bindings.of(name), timeout=limit) for name, limit in limits.items() if limit is not None}
        return replace(bindings, actions={**bindings.actions, **timed})

    # --- writing ---

    def text(self) -> str:
        """Return them as YAML; `read_rates` reads it."""
        lines = ["# How attempts at calls ended, and after how many seconds, learned by `pnm learn`. Comments are not read.", "#"]
        rows: list[tuple[str, ...]] = [("", "attempts", "succeed", "95 %", "half within", "90 % within", "limit that fits")]
        for action in sorted({call.action for call in self.calls}):
            call = Call("", action)
            chance, seconds, limit = self.chance(call), self.seconds(call), self.limit(call)
            low, high = chance.interval()
            share = (f"{chance.success:.1%}", f"{low:.1%} to {high:.1%}") if chance.rests.n else ("", "")
            within = [f"{seconds.quantile(part):.3g} s" if seconds.rests.n else "" for part in (0.5, 0.9)]
            rows.append((action, str(chance.rests.n), *share, *within, f"{limit:.3g} s" if limit else ""))
        wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines += [f"# {'  '.join(map(str.ljust, row, wide))}".rstrip() for row in rows]
        for action, ways in ((row[0], self.groups[row[0],].outcomes) for row in rows[1:]):
            shares = ", ".join(f"{name} {count / sum(ways.values()):.1%}" for name, count in sorted(ways.items()))
            lines += [f"# outcomes of {action}: {shares}"] if shares else []
        lines += ["", "journals:  # each with the last of its records that is counted"]
        lines += [f"  {_key(id)}: {last}" for id, last in sorted(self.journals.items())]
        lines += [
            "",
            "servers:  # for each its calls: ends, outcomes; the sum of all seconds until success, or until another end, and its parts",
        ]
        for server in sorted({call.server for call in self.calls}):
            lines.append(f"  {_key(server)}:")
            for call in sorted(call for call in self.calls if call.server == server):
                counts = self.calls[call]
                ends = ", ".join(f"{end}: {counts.ends[end]}" for end in End if end in counts.ends)
                lines += [f"    {_key(str(call))}:", f"      ends: {{{ends}}}"]
                if counts.outcomes:
                    lines.append(f"      outcomes: {{{', '.join(f'{_key(name)}: {n}' for name, n in sorted(counts.outcomes.items()))}}}")
                for key, times in (("took", counts.took), ("failed_after", counts.failed_after)):
                    if times.steps:
                        parts = [f"{count}*{STEP**step:.4g}" for step, count in sorted(times.steps.items())]
                        lines.append(f"      {key}: {times.total / 1000.0} = {' '.join(parts)}")
        return "\n".join((*lines, ""))


def read_rates(path: Path | str) -> Rates:
    """Read a file of rates; raise `InputError` where something is wrong."""
    from pnm.files.yaml_nodes import load_yaml  # here, because most commands read none

    top = load_yaml(path)
    top.only("journals", "servers")
    journals, calls = top.section("journals"), []
    for server, entries in top.section("servers").mappings().items():
        for written, where, node in entries.entries():
            if not _CALL.fullmatch(written):
                raise InputError(f"expected a call such as move(robot, hall), found {written!r}", where)
            action, *arguments = [json.loads(word) if word[0] == '"' else word for word in re.findall(_WORD, written)]
            entry = node.mapped()
            entry.only("ends", "outcomes", "took", "failed_after")
            ends, outcomes = entry.section("ends"), entry.section("outcomes")
            ends.only(*(end.value for end in End))
            found = {End(name): ends.whole(name, 0) for name in ends.nodes}
            times = _times(entry, "took"), _times(entry, "failed_after")
            counts = Counts(found, *times, {name: outcomes.whole(name, 0) for name in outcomes.nodes})
            calls.append((Call(server, action, tuple(arguments)), counts))
    return Rates(_summed(calls), {id: journals.whole(id, 0) for id in journals.nodes})


def update_rates(path: Path, change: Callable[[Rates], Rates]) -> None:
    """Have a file of rates changed as a whole, by one process at a time; raise an `InputError` if it cannot be read or written."""
    try:
        folder = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            before = read_rates(path) if path.exists() else NO_RATES
            if (after := change(before)) != before or not path.exists():
                write_private(path, after.text())
        finally:
            os.close(folder)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", Position(str(path))) from error


def _times(entry: Mapped, key: str) -> Times:
    node, steps = entry.filled(key), Counter[int]()
    if node is None:
        return Times()
    total, equals, parts = node.written.partition(" = ")
    try:
        for part in parts.split() if equals else ("",):
            count, seconds = part.split("*")
            if not count.isdecimal():
                raise ValueError(count)
            steps[step_of(float(seconds))] += int(count)
        return Times(dict(steps), round(1000.0 * float(total)))
    except (ValueError, OverflowError) as error:
        raise node.wrong(f"expected a sum of seconds such as 9.1 = 2*3.05 1*3, found {node.written[:40]!r}") from error


def _summed(counted: Iterable[tuple[Call, Counts]]) -> dict[Call, Counts]:
    """Return the sums by call, with so many arguments that there are few enough of every action.

    What one has left out the sum lacks as well: in whichever order they are added, the same comes out.
    """
    whole = _sums(counted)
    found: dict[Call, Counts] = {}
    for action in dict.fromkeys(call.action for call in whole):
        calls = {call: counts for call, counts in whole.items() if call.action == action}
        kept = min(len(call.arguments) for call in calls)
        while True:
            calls = _sums((call._replace(arguments=call.arguments[:kept]), counts) for call, counts in calls.items())
            if len(calls) <= MOST_CALLS or not kept:
                break
            kept -= 1
        found |= calls
    return found


def _sums(counted: Iterable[tuple[K, Counts]]) -> dict[K, Counts]:
    sums: dict[K, Counts] = {}
    for key, counts in counted:
        sums[key] = sums[key] + counts if key in sums else counts
    return sums


def _key(text: str) -> str:
    return text if re.fullmatch(r"[A-Za-z/][\w/-]*(\([\w, -]*\))?", text) else json.dumps(text, ensure_ascii=False)


NO_RATES: Final = Rates()
