"""Why there is no plan: the parts of the goal that no action can bring about, what would, and which condition is never true."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Final, TypeAlias, cast

from planner_bridge.model.problem import Problem
from planner_bridge.planning.reachability import Achiever, Reachability, TooLarge, Way, literal_of
from pnm.core.logic.conditions import Compare, Condition, conjuncts, fluents
from pnm.core.logic.expressions import Fluent, fluent_text, is_number

_LISTED: Final = 3
"""Facts, conditions and reasons that are named; others are counted."""
_LENGTH: Final = 400
"""Characters after which no further reason is given."""


class _Ending(Enum):
    """How a way to the goal ends: the words for one condition or call, and for several."""

    NEVER = "is never true", "are never true"
    UNKNOWN = "is unknown", "are unknown"
    NO_VALUE = "has no value", "have no value"
    FORBIDDEN = "must not be used", "must not be used"


_Said: TypeAlias = tuple[_Ending, str]


def why_unreachable(problem: Problem) -> str:
    """Return which parts of the goal cannot be reached, and why, whatever unknown facts are.

    Empty when all can as far as this shows, or the problem is too large.
    """
    return _why(problem, problem.unknown, "cannot be reached")


def why_unknown(problem: Problem) -> str:
    """Return which parts of the goal cannot be reached if unknown facts are false, and why; empty as for `why_unreachable`."""
    return _why(problem, frozenset(), "cannot be reached with what is known")


def _why(problem: Problem, possible: frozenset[Fluent], verdict: str) -> str:
    reachability = Reachability(problem, possible)
    try:
        reachability.settle(problem.goal)
    except TooLarge:
        return ""
    reasons: dict[tuple[_Said, ...], list[tuple[str, list[str]]]] = {}
    for part in conjuncts(problem.goal):
        if reachability.of(part):
            endings, actions = _reason(reachability, problem, part)
            reasons.setdefault(endings, []).append((str(part), actions))
    text, left = "", len(reasons)
    for endings, parts in reasons.items():
        actions = parts[0][1]
        would = f"{actions[0]} would {'do it' if len(parts) == 1 else 'do the first'}, but " if actions else ""
        why = _clauses(endings, actions[-1] if actions[1:] else "")
        if not actions and len(endings) == 1 and endings[0][0] is _Ending.NEVER and endings[0][1].startswith(parts[0][0]):
            why = f"no action brings it about{endings[0][1].removeprefix(parts[0][0])}"
        reason = f"{'; ' if text else ''}{_listed([part for part, _ in parts])} {verdict}: {would}{why}"
        if text and len(text) + len(reason) > _LENGTH:
            return f"{text}; and {left} more"
        text, left = text + reason, left - 1
    return text


def _reason(reachability: Reachability, problem: Problem, part: Condition) -> tuple[tuple[_Said, ...], list[str]]:
    """Return why a part of the goal cannot be reached, and the actions on the way there: the cheapest way is followed to where it ends."""
    lacks, way = reachability.lacking(part), list[str]()
    while not (ends := tuple(filter(reachability.is_end, lacks))):
        ways = [reachability.way(literal) for lack in lacks if (literal := literal_of(lack))]
        open = next((found for found in ways if found.by), None)
        if way and not open:
            break  # what actions are there for, but none can bring about
        if open:
            achiever = _nearest(reachability, open)
        else:
            achiever = min((achiever for found in ways for achiever in found.achievers), key=reachability.likelihood)
        way.append(achiever.name)
        lacks = reachability.lacking(achiever.condition, achiever.env)
    endings = (ending for lack in ends or lacks for ending in _endings(reachability, problem, lack))
    return tuple(endings), list(filter(None, way if way and way[-1] else way[:1]))


def _nearest(reachability: Reachability, way: Way) -> Achiever:
    """Return the action that people think of first, of those that only need what nothing brings about; else one on the cheapest way."""
    cheapest = reachability.cost(way.lack)
    near = [
        achiever
        for achiever in way.achievers
        if reachability.cost(reachability.of(achiever.condition, achiever.env)) == cheapest
        and all(map(reachability.is_end, reachability.lacking(achiever.condition, achiever.env)))
    ]
    return min(near, key=reachability.likelihood) if near else cast("Achiever", way.by)


def _endings(reachability: Reachability, problem: Problem, lack: Condition) -> Iterator[_Said]:
    """Yield what there is to say of a condition that does not hold."""
    literal, mentioned = literal_of(lack), fluents(lack, reachability.state)
    if guarded := [problem.guards[fluent] for fluent in mentioned & problem.guards.keys()]:
        yield from ((_Ending.FORBIDDEN, call) for call in guarded)
    elif problem.unknown & mentioned:
        yield _Ending.UNKNOWN, str(lack)
    elif literal and isinstance(literal.subject, Compare) and (missing := reachability.without_value(literal.subject)):
        yield from ((_Ending.NO_VALUE, fluent_text(fluent)) for fluent in missing)
    else:
        numbers = {fluent_text(fluent): value for fluent in sorted(mentioned) if is_number(value := reachability.state.value(fluent))}
        values = [f"{value:g}" if len(numbers) == 1 else f"{text} is {value:g}" for text, value in numbers.items()]
        yield _Ending.NEVER, f"{lack} [now {', '.join(values)}]" if values else str(lack)


def _clauses(endings: tuple[_Said, ...], action: str) -> str:
    """Return why the conditions do not hold, which the action needs if there is one."""
    kinds: dict[_Ending, dict[str, None]] = {}
    for ending, text in endings:
        kinds.setdefault(ending, {})[text] = None
    clauses, needs = list[str](), f"{action} needs "
    for ending, texts in kinds.items():
        what, verb = _listed([*texts]), ending.value[len(texts) > 1]
        if action and ending is not _Ending.FORBIDDEN:
            what, verb, needs = f"{needs}{what}", f", which {verb}", ""
        clauses.append(what + (verb if verb.startswith(",") else f" {verb}"))
    return ", and ".join(clauses)


def _listed(texts: list[str]) -> str:
    more = [f"{len(texts) - _LISTED} more"] if len(texts) > _LISTED else []
    shown = [*texts[:_LISTED], *more]
    return " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
