"""Timeline of a task: what its plans wanted when, and what was done when, as a plain value, as its picture, and as a log for mining.

All times are in seconds from the beginning of the task.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from statistics import median
from typing import Final

from pnm.core.machine.requests import OutcomeKind
from pnm.core.pictures.xml_text import COLOUR, cut, picture, short, xml


@dataclass(frozen=True, slots=True)
class TimedAttempt:
    """A request that was sent for a call."""

    sent: float
    ended: float | None = None
    """None while it is under way."""
    outcome: OutcomeKind | None = None
    """Its end."""
    message: str = ""
    """The message of its server about that."""


@dataclass(frozen=True, slots=True)
class TimedCall:
    """A call of a plan."""

    number: int
    """In its plan."""
    name: str
    """With its arguments."""
    lane: str
    """Whose it is, such as a robot."""
    planned: float
    """Its planned start."""
    duration: float | None = None
    """Its planned duration; None when that is unknown."""
    attempts: tuple[TimedAttempt, ...] = ()
    """Those whose requests were sent under this plan; a later plan may have taken the last one over."""
    outcome: str = ""
    """Its result under this plan, in words."""
    is_done: bool = False
    """It succeeded, or was not needed."""
    is_failed: bool = False
    declared: str = ""
    """Which of the declared outcomes of its action it has had, if there are several."""


@dataclass(frozen=True, slots=True)
class Replan:
    """Why a plan took the place of another, and how they differ: what was still to be done before, and what is now."""

    why: str
    kept: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    added: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TimedPlan:
    """A plan, from when it was begun to when another took its place."""

    began: float
    calls: tuple[TimedCall, ...]
    replan: Replan | None = None
    """None for the first plan, and for those that are carried out for a call of another."""
    failures: tuple[str, ...] = ()
    """Its failure and the reason."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """The timeline of a task."""

    goal: str
    plans: tuple[TimedPlan, ...] = ()
    now: float = 0.0
    """The time until which it tells everything: the end, if there is one."""
    ending: str = ""
    """The end of the task, in words; empty while it goes on."""
    id: str = ""
    """Of the task."""
    wall: float = 0.0
    """The time of day of its beginning, in seconds since 1970."""


def replan(why: str, left: Iterable[str], new: Iterable[str]) -> Replan:
    """Return the relation of a plan to an earlier one, of which these calls were left."""
    before, after = Counter(left), Counter(new)
    kept, dropped, added = before & after, before - after, after - before
    return Replan(why, *(tuple(part.elements()) for part in (kept, dropped, added)))


# --- as XES -----------------------------------------------------------------------------------


_EXTENSIONS: Final = {"Concept": "concept", "Lifecycle": "lifecycle", "Organizational": "org", "Time": "time"}


def timelines_xes(timelines: Iterable[Timeline]) -> str:
    """Return a log as XES (IEEE 1849): a trace for each task, whose events are starts and ends of requests, and new plans.

    The times of day follow from that of the beginning and the clock of the run. Calls for which nothing was sent are not in it.
    """
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<log xes.version="1849.2016" xmlns="http://www.xes-standard.org/">']
    for name, prefix in _EXTENSIONS.items():
        lines.append(f'<extension name="{name}" prefix="{prefix}" uri="http://www.xes-standard.org/{prefix}.xesext"/>')
    lines.append('<classifier name="call and lifecycle" keys="concept:name lifecycle:transition"/>')
    for timeline in timelines:
        about = {"concept:name": timeline.id, "goal": timeline.goal, "ending": timeline.ending}
        lines += ["<trace>", *_strings(about)]
        for time, event in sorted(logged(timeline), key=lambda event: event[0]):
            moment = datetime.fromtimestamp(timeline.wall + time, UTC).isoformat(timespec="milliseconds")
            lines += ["<event>", *_strings(event), f'<date key="time:timestamp" value="{moment}"/>', "</event>"]
        lines.append("</trace>")
    return "\n".join((*lines, "</log>", ""))


def _strings(values: Mapping[str, str]) -> Iterator[str]:
    return (f'<string key="{key}" value="{xml(value)}"/>' for key, value in values.items() if value)


def logged(timeline: Timeline) -> Iterator[tuple[float, Mapping[str, str]]]:
    """Yield the events of a trace, each with its time, in no order."""
    for number, plan in enumerate(timeline.plans):
        if plan.replan:
            yield plan.began, {"concept:name": "new plan", "lifecycle:transition": "complete", "reason": plan.replan.why}
        for call in plan.calls:
            about = {"concept:name": call.name, "action": call.name.partition("(")[0], "org:resource": call.lane}
            about["concept:instance"] = f"{number}.{call.number}"
            for attempt in call.attempts:
                yield attempt.sent, {**about, "lifecycle:transition": "start"}
                if attempt.ended is not None and attempt.outcome is not None:
                    how = "complete" if attempt.outcome is OutcomeKind.SUCCEEDED else "ate_abort"
                    result = {"outcome": attempt.outcome.value, "message": attempt.message}
                    yield attempt.ended, {**about, "lifecycle:transition": how, **result}


# --- as SVG ---------------------------------------------------------------------------------
#
# A lane for each robot, planned bars (thin) above those of what was done (thick), and a cut per new plan.
#
# Bars of one lane that would lie over each other are in rows. Of a plan that another one has replaced, only what was begun is drawn, and
# only until then; the words below name the rest, and the calls that take no time.


_LEFT: Final = 112
"""Pixels for the names of lanes."""
_RIGHT: Final = 90
_WIDTH: Final = (900, 20000)
"""Pixels of the time, at least and at most."""
_CALL: Final = 90
"""Pixels of a usual call, at least."""
_TOP: Final = 44
_ROW: Final = 44
"""Pixels of a row: a thin bar, a thick one, and a line of words."""
_LINE: Final = 18
"""Pixels of a line of words below."""
_LETTER: Final = 6.8
"""Pixels of a letter."""
_TICK: Final = 90
"""Pixels from one time on the axis to the next, at least."""
_KEY: Final = "thin: as planned   thick: as done   ✗ failed   ⊘ cancelled   → under way   ↻ a new plan"
_STYLE: Final = (
    "text{{font:12px sans-serif;fill:{text}}}.name{{font-weight:bold}}.far{{fill:{dim}}}.words{{fill:{bad}}}"
    ".planned{{fill:{surface};stroke:{edge}}}.done{{fill:{ok_s};stroke:{ok_e}}}.failed{{fill:{bad_s};stroke:{bad}}}"
    ".canceled{{fill:{track};stroke:{edge}}}.going{{fill:{run_s};stroke:{run}}}path{{fill:none;stroke:{line}}}"
    ".cut{{stroke:{cut};stroke-dasharray:4 3}}.why{{fill:{cut}}}"
).format_map(COLOUR)


@dataclass(frozen=True, slots=True)
class _Bar:
    """A call with what is drawn of it."""

    call: TimedCall
    planned: tuple[float, float] | None
    """From when to when; None if it was to begin only after its plan was replaced."""
    done: tuple[float, float] | None


def timeline_svg(*timelines: Timeline) -> str:
    """Return the picture of the timelines of one task, or of several below each other; the same timelines give the same text."""
    drawn: list[str] = []
    width, top = 0.0, 0.0
    for timeline in timelines:
        parts, wide, high = _task(timeline)
        drawn += (f'<g transform="translate(0 {top:g})">', *parts, "</g>")
        width, top = max(width, wide), top + high
    title = timelines[0].goal if len(timelines) == 1 else f"{len(timelines)} tasks"
    return picture("timeline", title, _STYLE, max(width, _LEFT + _WIDTH[0] + _RIGHT), max(top, _TOP), drawn)


def _task(timeline: Timeline) -> tuple[list[str], float, float]:
    """Return the picture of one task, with its width and its height."""
    bars = _bars(timeline)
    ends = [end for bar in bars for part in (bar.planned, bar.done) if part for end in part]
    span = max((timeline.now, *ends)) or 1.0
    usual = median(lengths) if (lengths := [end - begin for bar in bars if bar.done for begin, end in [bar.done] if end > begin]) else span
    scale = min(max(_WIDTH[0] / span, _CALL / usual), _WIDTH[1] / span)
    lanes: dict[str, list[list[_Bar]]] = {}
    for bar in bars:
        rows = lanes.setdefault(bar.call.lane, [])
        fitting = next((row for row in rows if not any(_meet(bar, other, 2.0 / scale) for other in row)), None)
        if fitting is None:
            rows.append([bar])
        else:
            fitting.append(bar)
    bottom = _TOP + _ROW * sum(map(len, lanes.values()))
    width = _LEFT + span * scale + _RIGHT
    parts = [f'<text class="name" x="10" y="16">{short(timeline.goal, int(width / 8))}</text>']
    parts += _axis(span, scale, bottom)
    y = _TOP
    for lane, rows in lanes.items():
        parts.append(f'<path d="M0 {y}H{width:g}"/><text class="name" x="10" y="{y + 20}">{short(lane, 13)}</text>')
        for row in rows:
            row.sort(key=_named_at)
            for bar, following in zip(row, [*row[1:], None], strict=True):
                parts += _drawn(bar, y, scale, _named_at(following) if following else span + _RIGHT / scale)
            y += _ROW
    parts.append(f'<path d="M0 {bottom}H{width:g}"/>')
    words = [*_words(timeline, bars)]
    for number, (plan, new) in enumerate(_replans(timeline), 1):
        x = _LEFT + plan.began * scale
        parts.append(f'<g><title>{xml(new.why)}</title><path class="cut" d="M{x:g} {_TOP - 8}V{bottom}"/>')
        parts.append(f'<text class="why" x="{x + 2:g}" y="{_TOP - 2}">↻{number}</text></g>')
    for line, (kind, text) in enumerate(words, 1):
        x, y = 24 if kind == "far" else 10, bottom + _LINE * line + 3
        parts.append(f'<text class="{kind}" x="{x}" y="{y:g}">{short(text, int((width - x) / _LETTER))}</text>')
    return parts, width, bottom + _LINE * len(words) + 16


def _bars(timeline: Timeline) -> list[_Bar]:
    """Return the drawn bars of the calls, in the order in which they begin."""
    bars = []
    cuts = [plan.began for plan, _ in _replans(timeline)]
    for plan in timeline.plans:
        replaced = next((when for when in cuts if when > plan.began), None)
        for call in plan.calls:
            if call.attempts:
                last = call.attempts[-1].ended
                done = call.attempts[0].sent, timeline.now if last is None else last
            elif replaced is None and call.duration is not None:
                done = None
            else:
                continue
            begin, end = max(call.planned, plan.began), call.planned + (call.duration or 0.0)
            end = end if replaced is None else min(end, replaced)
            planned = (begin, end) if call.duration is not None and begin <= end else None
            if planned or done:
                bars.append(_Bar(call, planned, done))
    return sorted(bars, key=_begin)


def _begin(bar: _Bar) -> float:
    return min(part[0] for part in (bar.planned, bar.done) if part)


def _named_at(bar: _Bar) -> float:
    """Return where the name of a call begins: at what was done, if there is something."""
    return bar.done[0] if bar.done else _begin(bar)


def _meet(one: _Bar, other: _Bar, gap: float) -> bool:
    """Return whether bars of two calls would lie over each other, or be nearer than this."""
    pairs = ((one.planned, other.planned), (one.done, other.done))
    return any(a and b and a[0] < max(b[1], b[0] + gap) and b[0] < max(a[1], a[0] + gap) for a, b in pairs)


def _axis(span: float, scale: float, bottom: float) -> Iterator[str]:
    """Yield the seconds above the lanes, at round numbers."""
    step = next(size * 10.0**power for power in range(-3, 9) for size in (1, 2, 5) if size * 10.0**power * scale >= _TICK)
    for number in range(int(span / step) + 1):
        x = _LEFT + number * step * scale
        yield f'<path d="M{x:g} {_TOP - 8}V{bottom:g}"/>'
        yield f'<text class="far" x="{x:g}" y="{_TOP - 14}" text-anchor="middle">{number * step:g} s</text>'


def _drawn(bar: _Bar, y: float, scale: float, until: float) -> Iterator[str]:
    """Yield the bars of a call, and its name as far as there is room until the next one."""
    call = bar.call
    yield f'<g class="call"><title>{xml(_title(call))}</title>'
    if bar.planned:
        begin, end = bar.planned
        yield f'<rect class="planned" x="{_LEFT + begin * scale:g}" y="{y + 4:g}" width="{max((end - begin) * scale, 2):g}" height="4"/>'
    noted: list[tuple[float, str]] = []
    for attempt in call.attempts:
        kind, sign = _look(attempt)
        ended = bar.done[1] if attempt.ended is None and bar.done else attempt.ended or attempt.sent
        x, width = _LEFT + attempt.sent * scale, max((ended - attempt.sent) * scale, 2)
        yield f'<rect class="{kind}" x="{x:g}" y="{y + 11:g}" width="{width:g}" height="16" rx="2"/>'
        if sign:
            noted.append((attempt.sent, f"{sign} {_how(attempt)}"))
    if call.is_failed and (not call.attempts or call.attempts[-1].outcome is OutcomeKind.SUCCEEDED):
        noted.append((call.attempts[-1].sent if call.attempts else _begin(bar), f"✗ {call.outcome}"))
    elif call.declared:
        noted.append((call.attempts[-1].sent if call.attempts else _begin(bar), call.declared))
    elif not call.attempts:
        noted.append((_begin(bar), call.outcome))
    (begins, last), wide = bar.done or bar.planned or (until, until), len(call.name) * _LETTER + 6
    ends = call.attempts[1].sent if len(call.attempts) > 1 else last
    is_beside = (ends - begins) * scale < wide <= (until - last) * scale  # else it is in the bar of its first attempt, as far as it fits
    yield from _written("", y + 23.5, scale, [(last if is_beside else begins, call.name)], until if is_beside else ends)
    has_failed = any(text.startswith("✗") for _, text in noted)
    yield from _written("words" if has_failed else "far", y + 39, scale, noted, until)
    yield "</g>"


def _written(kind: str, y: float, scale: float, words: Sequence[tuple[float, str]], until: float) -> Iterator[str]:
    """Yield words at their times, as far as there is room until the next ones; where there is none, their sign alone."""
    for (time, text), (following, _) in pairwise((*words, (until, ""))):
        letters = int(((following - time) * scale - 6) / _LETTER)
        shown = cut(text, letters) if letters > 2 else text[:1] if kind else ""
        if shown:
            yield f'<text class="{kind}" x="{_LEFT + time * scale + 3:g}" y="{y:g}">{xml(shown)}</text>'


def _look(attempt: TimedAttempt) -> tuple[str, str]:
    """Return the kind of an attempt, and a sign: nothing is said by colours alone."""
    match attempt.outcome:
        case None:
            return "going", "→"
        case OutcomeKind.SUCCEEDED:
            return "done", ""
        case OutcomeKind.CANCELED:
            return "canceled", "⊘"
        case _:
            return "failed", "✗"


def _how(attempt: TimedAttempt) -> str:
    how = attempt.outcome.value if attempt.outcome else "under way"
    return f"{how}: {attempt.message}" if attempt.message else how


def _title(call: TimedCall) -> str:
    lines = [call.name, f"planned at {call.planned:.2f} s{'' if call.duration is None else f' for {call.duration:.2f} s'}"]
    for number, attempt in enumerate(call.attempts, 1):
        ended = "" if attempt.ended is None else f" to {attempt.ended:.2f} s"
        lines.append(f"attempt {number}: {attempt.sent:.2f}{ended}, {_how(attempt)}")
    return "\n".join((*lines, call.outcome))


def _replans(timeline: Timeline) -> list[tuple[TimedPlan, Replan]]:
    return [(plan, plan.replan) for plan in timeline.plans if plan.replan]


def _words(timeline: Timeline, bars: Sequence[_Bar]) -> Iterator[tuple[str, str]]:
    """Yield the texts below the lanes, with their kinds: failures, new plans with kept, dropped and added calls, and the ending."""
    number = 0
    drawn = {id(bar.call) for bar in bars}
    for plan in timeline.plans:
        if (new := plan.replan) is not None:
            number += 1
            yield "why", f"↻{number}  {plan.began:.2f} s: {new.why}"
            for word, names in (("kept", new.kept), ("dropped", new.dropped), ("added", new.added)):
                if names:
                    yield "far", f"{word} {len(names)}: {', '.join(names)}"
        if others := [f"{call.name} ({call.outcome})" for call in plan.calls if id(call) not in drawn]:
            yield "far", f"not drawn {len(others)}: {', '.join(others)}"
        yield from (("words", f"✗  {failure}") for failure in plan.failures)
    if timeline.ending:
        yield "", f"{timeline.now:.2f} s: {timeline.ending}"
    yield "far", _KEY
