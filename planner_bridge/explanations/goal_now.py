"""Whether a goal can be reached from the world as it is; if not, why, and what would help.

That is asked where the world is known, and answered in another process.
"""

from __future__ import annotations

import base64
import pickle
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Final, TypeAlias

from planner_bridge.explanations.answer import Answer, Known, NoSmallerChange, Solves
from planner_bridge.explanations.needed_call import why_plan
from planner_bridge.explanations.no_plan import SECONDS, AnswerLimit, why_no_plan, why_not_short
from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Rates
from planner_bridge.planning.reachability import GoalLiteral, Reachability, TooLarge, literal_of
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Compare, Condition, parts_of
from pnm.core.logic.expressions import NOTHING, Environment, Fluent, Value, choices, fluent_text
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.errors import counted, listed


def packed(problem: Problem, bindings: Bindings = NO_BINDINGS) -> str:
    """Return a problem and the bindings of its actions as a text for another process of this program: PDDL lacks what is unknown."""
    return base64.b64encode(zlib.compress(pickle.dumps((problem, bindings)))).decode()


def unpacked(text: str) -> tuple[Problem, Bindings]:
    """Return the problem and the bindings of a text that a process which is trusted has made."""
    problem, bindings = pickle.loads(zlib.decompress(base64.b64decode(text)))
    assert isinstance(problem, Problem)
    assert isinstance(bindings, Bindings)
    return problem, bindings


def answered(text: str, world: KnowledgeBase) -> tuple[Answer, ...]:
    """Return the answers about the goal of a problem that was packed, from a world."""
    problem, limit = problem_now(unpacked(text)[0], world), AnswerLimit.of(SECONDS)
    return why_goal(problem, limit.first_plan(problem), limit)


def first_plan(text: str, world: KnowledgeBase, learned: Rates = NO_RATES) -> tuple[Problem, Bindings, PlanningResult]:
    """Return a problem that was packed, as it is from a world, with its bindings, and the first plan that is found for it soon."""
    problem, bindings = unpacked(text)
    problem = problem_now(problem, world)
    return problem, bindings, AnswerLimit.of(SECONDS, bindings, learned).first_plan(problem)


def why_goal(problem: Problem, found: PlanningResult, limit: AnswerLimit) -> tuple[Answer, ...]:
    """Return the purpose of each call of a plan; or why there is none, and what would help."""
    if found.plan is not None:
        short = why_not_short(problem, found.plan, limit) if found.policy and found.policy.entries else None
        return tuple(filter(None, (why_plan(problem, found.plan), short)))
    reason = why_no_plan(problem, found, limit)
    return reason, what_would_help(problem, limit, reason)


# --- smallest change ------------------------------------------------------------------------------
# What would make a goal possible: a smallest change of facts, proved by planning.
#
# Which changes could help at all follows from reachability: every literal gets *labels*, sets of facts that would have to be otherwise
# so that it can be reached if nothing were ever undone (de Kleer, An assumption-based TMS, 1986). A set of changes that holds no label
# of the goal leaves it unreachable, whatever the plan; each label is tried by planning from the changed state. Only facts are changed,
# neither numbers nor the facts that the goal itself asks for.


_MOST: Final = 3
"""Facts that are changed, at most."""
_SHOWN: Final = 3
"""Changes of the same size that are looked for."""
_FOR_LABELS: Final = 0.25
"""Share of the time for labels; the rest is for searches."""
_LABELS: Final = 60
"""Labels of one literal; with more, not all changes are looked at."""
_NUMBERS = ("no fact", "one fact", "two facts", "three facts")

Label: TypeAlias = frozenset[GoalLiteral]
_NONE: Final[frozenset[Label]] = frozenset({frozenset()})


def changed(problem: Problem, change: Iterable[GoalLiteral]) -> Problem:
    """Return the problem that begins with these facts as they are given."""
    init, known = dict[Fluent, Value](problem.init), set[Fluent]()
    for fluent, truth in change:
        assert isinstance(fluent, tuple), "only facts are changed"
        known.add(fluent)
        init.pop(fluent, None)
        if truth:
            init[fluent] = True
    return replace(problem, init=init, unknown=problem.unknown - known)


def _facts_in(reachability: Reachability, condition: Condition, env: Environment = NOTHING, truth: bool = True) -> Iterator[Fluent]:
    """Yield the facts that the goal itself asks for, which are not changed: that would be no answer."""
    if literal := literal_of(condition, env, truth):
        if isinstance(literal.subject, tuple):
            yield literal.subject
    else:
        for part in parts_of(condition, reachability.state, env, truth)[0]:
            yield from _facts_in(reachability, *part)


@dataclass
class Labels:
    """The labels of literals, with at most so many facts each. The mutable state is these, and whether some were left out."""

    reachability: Reachability
    fixed: frozenset[Fluent]
    """Facts that are not changed."""
    most: int
    of_literal: dict[GoalLiteral, frozenset[Label]] = field(default_factory=dict)
    is_complete: bool = True

    def settle(self, goal: Condition, limit: AnswerLimit) -> frozenset[Label]:
        """Return the labels of the goal."""
        found, is_settled = self.of(goal), False
        while not is_settled:
            known, is_settled = [*self.of_literal], True
            for literal in known:
                if limit.is_over:
                    self.is_complete = False
                    return found
                if self.of_literal[literal] == _NONE:
                    continue  # it needs no change
                ways = [self.of(achiever.condition, achiever.env) for achiever in self.reachability.way(literal).achievers]
                labels = self._least(self.of_literal[literal].union(*ways))
                if labels != self.of_literal[literal]:
                    self.of_literal[literal], is_settled = labels, False
            found = self.of(goal)
            is_settled = is_settled and len(known) == len(self.of_literal)
        return found

    def of(self, condition: Condition, env: Environment = NOTHING, truth: bool = True) -> frozenset[Label]:
        """Return the labels of a condition, or of its opposite, so far."""
        if literal := literal_of(condition, env, truth):
            if literal not in self.of_literal:
                subject, derived = literal.subject, self.reachability.state.rules.derived
                is_changeable = isinstance(subject, tuple) and subject not in self.fixed and subject[0] not in derived
                own = frozenset({frozenset({literal})}) if is_changeable else frozenset[Label]()
                self.of_literal[literal] = own if self.reachability.way(literal).lack else _NONE
            return self.of_literal[literal]
        parts, is_every = parts_of(condition, self.reachability.state, env, truth)
        if not is_every:
            return self._least(frozenset[Label]().union(*(self.of(*part) for part in parts)))
        joined = _NONE
        for part in parts:
            joined = self._least(frozenset(one | other for one, other in product(joined, self.of(*part))))
        return joined

    def _least(self, labels: frozenset[Label]) -> frozenset[Label]:
        """Return the labels that hold no other one and are not too large; of too many the smallest."""
        kept: list[Label] = []
        for label in sorted((label for label in labels if len(label) <= self.most), key=_by_size):
            if not any(other <= label for other in kept):
                kept.append(label)
        self.is_complete = self.is_complete and len(kept) <= _LABELS
        return frozenset(kept[:_LABELS])


def _by_size(label: Label) -> tuple[int, list[tuple[str, bool]]]:
    return len(label), sorted((str(subject), truth) for subject, truth in label)


def what_would_help(problem: Problem, limit: AnswerLimit, reason: Answer) -> Answer:
    """Return the smallest changes of facts after which there is a plan."""
    if (reachability := limit.reached(problem)) is None:
        return Answer("helpful changes were not searched: the problem is too large", Known.NOT_PROVED)
    fixed, proved, is_exhaustive = frozenset(_facts_in(reachability, problem.goal)), 0, reason.known.is_certain
    for size in range(1, _MOST + 1):
        labels = Labels(reachability, fixed, size)
        of_goal = labels.settle(problem.goal, AnswerLimit.of(limit.left * _FOR_LABELS))
        is_reachable = frozenset() in of_goal  # if nothing were undone: then any fact may be the one
        facts = (frozenset({literal}) for literal in _facts(problem, reachability, fixed)) if is_reachable else of_goal
        try:
            candidates = sorted((label for label in facts if len(label) == size), key=partial(_rank, reachability))
        except TooLarge:
            return Answer("helpful changes were not searched: there are too many facts", Known.NOT_PROVED)
        reasons, all_proved = _try(problem, candidates, limit)
        if reasons:
            least = f"no change of {_NUMBERS[size - 1]} is enough" if size > 1 else "without a change there is no plan"
            if proved == size - 1 and reason.known.is_certain:
                reasons += (Answer(least, reason.known, (), (NoSmallerChange(problem, size),)),)
            else:
                reasons += (Answer(f"it is not proved that {least}", Known.NOT_PROVED),)
            return Answer(f"there would be a plan with {_NUMBERS[size]} changed", Known.PLAN, reasons)
        if is_exhaustive and labels.is_complete and all_proved:
            proved = size
        is_exhaustive = is_exhaustive and not candidates  # what does not help alone may do so together with something else
        if is_reachable or limit.is_over:
            break
    numbers = [lack for lack in reachability.of(problem.goal) if (literal := literal_of(lack)) and isinstance(literal.subject, Compare)]
    reasons = (Answer(f"numbers were not changed, and it takes {listed(sorted(map(str, numbers)))}", Known.GIVEN),) if numbers else ()
    if proved:
        text = f"changing {_NUMBERS[proved]} is not enough, unless it is one of the goal itself"
        return Answer(text, Known.SEARCH, reasons, (NoSmallerChange(problem, proved + 1),))
    return Answer("no change of facts was found that would help", Known.NOT_PROVED, reasons)


def _facts(problem: Problem, reachability: Reachability, fixed: frozenset[Fluent]) -> Iterator[GoalLiteral]:
    """Yield every fact that the domain knows, as it would be if it were changed."""
    for name, declared in problem.domain.predicates.items():
        if name in reachability.state.rules.derived:
            continue
        for env in choices(declared.parameters, reachability.state, NOTHING):
            fluent = (name, *(str(env[variable.name]) for variable in declared.parameters))
            if fluent not in fixed:
                yield GoalLiteral(fluent, reachability.state.value(fluent) is not True)


def _rank(reachability: Reachability, label: Label) -> tuple[int, int, list[tuple[str, bool]]]:
    """Return the place of a change in the order of trying: first what no action changes, then switches before maps and tables."""
    ways = [reachability.way(literal) for literal in label]
    return sum(bool(way.achievers) for way in ways), sum(way.weight for way in ways), _by_size(label)[1]


def _try(problem: Problem, candidates: Iterable[Label], limit: AnswerLimit) -> tuple[tuple[Answer, ...], bool]:
    """Look for plans after each of the changes, until enough help; return those, and whether it is proved that no other one does."""
    found: list[Answer] = []
    all_proved = True
    for label in candidates:
        if len(found) == _SHOWN or limit.is_over:
            break
        asked = changed(problem, label)
        result = limit.solve(asked, share=0.2)
        if plan := result.plan:
            text = f"if {_text(problem, label)}: a plan with {counted(len(plan.steps), 'call')}"
            found.append(Answer(text, Known.PLAN, (), (Solves(asked, plan),)))
        all_proved = all_proved and result.status is PlanningStatus.UNSOLVABLE
    return tuple(found), all_proved and not limit.is_over


def _text(problem: Problem, label: Label) -> str:
    texts = []
    for subject, truth in sorted(label, key=str):
        assert isinstance(subject, tuple), "only facts are changed"
        if subject in problem.guards:
            texts.append(f"{problem.guards[subject]} might be used")
        else:
            texts.append(f"{fluent_text(subject)} were {'true' if truth else 'false'}")
    return listed(texts)
