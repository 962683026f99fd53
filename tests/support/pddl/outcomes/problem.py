"""PDDL whose actions have several outcomes, read a second time: what the project's reading, worlds and policies are measured against.

Nothing of the project is used here. Read are STRIPS and ADL with `oneof` and `probabilistic` anywhere in effects; costs and rewards count
for nothing. The alternatives of a `oneof` are equally likely, those that are there twice twice as much.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path
from random import Random
from typing import NamedTuple, TypeAlias

from tests.support.pddl.outcomes.reading import Atom, Env, Node, bound, conjuncts, heads, parse, typed

State: TypeAlias = frozenset[Atom]
"""The facts that are so, of those that can change."""
Changes: TypeAlias = dict[Atom, bool]


class Outcome(NamedTuple):
    """One way in which an action ends."""

    chance: float
    changes: Changes


class Ground(NamedTuple):
    """An action with its arguments."""

    name: str
    arguments: Atom
    needs: frozenset[Atom]
    """Facts without which it cannot be."""
    conditions: list[Node]
    """What it needs besides."""
    effect: Node
    env: Env
    known: list[Outcome] | None
    """Its outcomes, if they are the same in every state."""


class Chance:
    """A problem whose actions have outcomes."""

    def __init__(self, domain: str, problem: str) -> None:
        sections, self.domain = [*parse(domain)[1:], *parse(problem)[1:]], parse(domain)
        parts: dict[str, list[Node]] = {}
        for section in sections:
            parts.setdefault(section[0], []).append(section[1:])
        self.types: dict[str, tuple[str, ...]] = {name: above for part in parts.get(":types", []) for name, above in typed(part)}
        self.objects: dict[str, tuple[str, ...]] = {}
        for part in (*parts.get(":constants", []), *parts.get(":objects", [])):
            for name, types in typed(part):
                self.objects[name] = (*self.objects.get(name, ()), *types)
        self.schemas = {one[0]: dict(zip(one[1::2], one[2::2], strict=True)) for one in parts.get(":action", [])}
        effects = {head for schema in self.schemas.values() for head in heads(schema.get(":effect"))}
        self.changing = frozenset(effects & {one[0] for part in parts.get(":predicates", []) for one in part})
        facts = frozenset(tuple(fact) for fact in parts[":init"][0] if fact[0] not in ("=", "not"))
        self.initial = frozenset(fact for fact in facts if fact[0] in self.changing)
        self.static = facts - self.initial
        self.goal = parts[":goal"][0][0]

    @staticmethod
    def read(folder: Path) -> Chance:
        """Read the `domain.pddl` and `problem.pddl` of a folder."""
        return Chance((folder / "domain.pddl").read_text(encoding="utf-8"), (folder / "problem.pddl").read_text(encoding="utf-8"))

    # --- objects and conditions -------------------------------------------------------------------

    @lru_cache(1000)  # noqa: B019  (one problem a process)
    def of_types(self, types: tuple[str, ...]) -> tuple[str, ...]:
        """Return the objects of any of the types."""

        def kinds(name: str) -> Iterator[str]:
            yield name
            for above in self.types.get(name, ()):
                yield from kinds(above) if above != name else ()

        fits = {name for name, own in self.objects.items() if {"object", *(kind for each in own for kind in kinds(each))} & set(types)}
        return tuple(name for name in self.objects if name in fits)

    def choices(self, variables: Iterable[tuple[str, tuple[str, ...]]], env: Env) -> Iterator[Env]:
        """Yield the environment with each choice of objects for the variables."""
        names = list(variables)
        for chosen in product(*(self.of_types(types) for _, types in names)):
            yield {**env, **{name: one for (name, _), one in zip(names, chosen, strict=True)}}

    def holds(self, node: Node, state: State, env: Env = {}) -> bool:  # noqa: B006  (read only)
        """Return whether a condition is so in a state."""
        match node:
            case []:
                return True
            case ["and", *parts]:
                return all(self.holds(part, state, env) for part in parts)
            case ["or", *parts]:
                return any(self.holds(part, state, env) for part in parts)
            case ["not", part]:
                return not self.holds(part, state, env)
            case ["imply", first, then]:
                return not self.holds(first, state, env) or self.holds(then, state, env)
            case ["forall", variables, part]:
                return all(self.holds(part, state, chosen) for chosen in self.choices(typed(variables), env))
            case ["exists", variables, part]:
                return any(self.holds(part, state, chosen) for chosen in self.choices(typed(variables), env))
            case ["=", left, right]:
                return bool(env.get(left, left) == env.get(right, right))
            case _:
                return (atom := bound(node, env)) in state or atom in self.static

    # --- actions ----------------------------------------------------------------------------------

    def outcomes(self, node: Node, state: State, env: Env) -> list[Outcome]:
        """Return the different ways in which an effect turns out in a state, with their chances."""
        match node:
            case [] | ["increase" | "decrease", *_]:
                return [Outcome(1.0, {})]
            case ["and", *parts]:
                return _product(self.outcomes(part, state, env) for part in parts)
            case ["forall", variables, part]:
                return _product(self.outcomes(part, state, chosen) for chosen in self.choices(typed(variables), env))
            case ["when", condition, part]:
                return self.outcomes(part if self.holds(condition, state, env) else [], state, env)
            case ["oneof", *parts]:
                return _merged((each, 1.0 / len(parts)) for part in parts for each in self.outcomes(part, state, env))
            case ["probabilistic", *parts]:
                chances = [float(Fraction(chance)) for chance in parts[::2]]
                pairs = [(1.0 - sum(chances), []), *zip(chances, parts[1::2], strict=True)]
                return _merged((each, chance) for chance, part in pairs if chance > 1e-9 for each in self.outcomes(part, state, env))
            case ["not", part]:
                return [Outcome(1.0, {bound(part, env): False})]
            case _:
                return [Outcome(1.0, {bound(node, env): True})]

    def after(self, state: State, changes: Changes) -> State:
        """Return the state with the changes."""
        gone = [atom for atom, value in changes.items() if not value]
        return state.difference(gone).union([atom for atom, value in changes.items() if value])

    def is_goal(self, state: State) -> bool:
        """Return whether the goal holds."""
        return self.holds(self.goal, state)

    def action(self, name: str, arguments: Iterable[str]) -> Ground:
        """Return an action with its arguments."""
        schema = self.schemas[name]
        env = {variable: one for (variable, _), one in zip(typed(schema.get(":parameters", [])), arguments, strict=True)}
        parts, effect = conjuncts(schema.get(":precondition", [])), schema.get(":effect", [])
        needs = frozenset(bound(part, env) for part in parts if part[0] in self.changing)
        known = None if "when" in heads(effect) else self.outcomes(effect, self.initial, env)
        return Ground(name, tuple(env.values()), needs, [part for part in parts if part[0] not in self.changing], effect, env, known)

    def is_possible(self, action: Ground, state: State) -> bool:
        """Return whether an action can begin."""
        return action.needs <= state and all(self.holds(part, state, action.env) for part in action.conditions)

    def successors(self, action: Ground, state: State) -> list[tuple[float, State]]:
        """Return the states after an action, with their chances."""
        merged: dict[State, float] = {}
        for chance, changes in action.known or self.outcomes(action.effect, state, action.env):
            after = self.after(state, changes)
            merged[after] = merged.get(after, 0.0) + chance
        return [(chance, after) for after, chance in merged.items()]

    def drawn(self, action: Ground, state: State, chance: Random) -> State:
        """Return a state after an action, drawn by the chances."""
        ends = self.successors(action, state)
        return chance.choices([after for _, after in ends], [share for share, _ in ends])[0]

    @cached_property
    def actions(self) -> list[Ground]:
        """All actions that what never changes allows."""
        found = [self.action(name, arguments) for name in self.schemas for arguments in self._arguments(name)]
        return [one._replace(conditions=[part for part in one.conditions if not self._is_static(part)]) for one in found]

    def _is_static(self, part: Node) -> bool:
        """Return whether a condition is a fact, or an equality, that never changes, or that this is not so."""
        inner = part[1] if part[0] == "not" else part
        return inner[0] not in self.changing and all(isinstance(word, str) for word in inner)

    def _arguments(self, name: str) -> Iterator[tuple[str, ...]]:
        schema = self.schemas[name]
        parameters = typed(schema.get(":parameters", []))
        order = {variable: number for number, (variable, _) in enumerate(parameters)}
        tests: list[list[Node]] = [[] for _ in range(len(parameters) + 1)]
        for part in filter(self._is_static, conjuncts(schema.get(":precondition", []))):
            words = part[1] if part[0] == "not" else part
            tests[max((order[word] + 1 for word in words if word in order), default=0)].append(part)

        def extended(env: dict[str, str], depth: int) -> Iterator[tuple[str, ...]]:
            if not all(self.holds(test, self.initial, env) for test in tests[depth]):
                return
            if depth == len(parameters):
                yield tuple(env.values())
                return
            variable, types = parameters[depth]
            for one in self.of_types(types):
                yield from extended({**env, variable: one}, depth + 1)

        return extended({}, 0)


def _merged(outcomes: Iterable[tuple[Outcome, float]]) -> list[Outcome]:
    """Return the outcomes with their chances times a factor, equal ones once."""
    merged: dict[frozenset[tuple[Atom, bool]], Outcome] = {}
    for (chance, changes), factor in outcomes:
        key = frozenset(changes.items())
        merged[key] = Outcome(chance * factor + (merged[key].chance if key in merged else 0.0), changes)
    return list(merged.values())


def _product(parts: Iterable[list[Outcome]]) -> list[Outcome]:
    """Return the outcomes of several effects at once: what one adds and another deletes is added."""
    found = [Outcome(1.0, {})]
    for part in parts:
        pairs = ((first, second) for first in found for second in part)
        found = _merged((_both(first.changes, second), first.chance) for first, second in pairs)
    return found


def _both(changes: Changes, outcome: Outcome) -> Outcome:
    kept = {atom: value for atom, value in outcome.changes.items() if not (value is False and changes.get(atom) is True)}
    return Outcome(outcome.chance, {**changes, **kept})
