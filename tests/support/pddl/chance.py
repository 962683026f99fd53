"""Small random problems whose actions have several outcomes, and exact answers about them by looking at every state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count, product
from random import Random

import pytest

from planner_bridge.model.grounding import ground_step, initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.odds import KnownRobots
from planner_bridge.planning.policies.policy import Policy, policies
from planner_bridge.planning.policies.proof import unproved
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import Alternative, changes
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.plan_graph import GroundAction

State = frozenset[tuple[Fluent, Value | Unknown]]

DOMAIN = """
(define (domain chance)
  (:requirements :adl :derived-predicates :non-deterministic :probabilistic-effects :numeric-fluents)
  (:types thing)
  (:predicates (p ?x - thing) (q ?x - thing) (r ?x - thing) (d ?x - thing) (e ?x - thing))
  (:functions (n) (m))
  {rules}{actions})
"""
PROBLEM = "(define (problem p) (:domain chance) (:objects a b - thing) (:init (= (n) 2) (= (m) 1) {init}) (:goal (and {goal})))"
FACTS = [f"({name} {thing})" for name in "pqr" for thing in "ab"]
RULES = """(:derived (d ?x - thing) (or {0} (exists (?y - thing) (and (d ?y) {1}))))
  (:derived (e ?x - thing) (or (and (not (d ?x)) {2}) (forall (?y - thing) (imply {3} (d ?y)))))
  """
"""Of which the first one leads from one fact to the next, and the other one asks that none does."""
RIVER = parse_problem(
    "(define (problem p) (:domain river) (:init (near)) (:goal (far)))",
    parse_domain("""(define (domain river) (:requirements :strips :non-deterministic) (:predicates (near) (far) (island))
  (:action wade :precondition (near) :effect (and (not (near)) (oneof (far) (and) (island) (island))))
  (:action swim :precondition (island) :effect (and (not (island)) (probabilistic 0.8 (far)))))"""),
)
"""A river that is crossed with a chance of 0.65, and from its island of 0.8."""
NEVER_FAILS = KnownRobots(faults=Faults((Fault("wade", FaultKind.ABORT, chance=0.0), Fault("swim", FaultKind.ABORT, chance=0.0))))


def to_the_island(action: GroundAction, _: Random) -> Fault:
    """Have whoever crosses the river come to its island first."""
    return Fault(action.name, outcome="3" if action.name == "wade" else "1")


def texts(seed: int, *, counts: bool = False, derives: bool = False) -> tuple[str, str]:
    """Return the texts of a random domain and problem with six facts, the goal of which does not hold at first.

    Args:
        counts: with two numbers that actions change, from 0 to 4.
        derives: with derived facts, on which actions and the goal depend.
    """
    random, read = Random(seed), "pqrdde" if derives else "pqr"

    def count() -> tuple[str, str]:
        """Return an effect on a number, and what it needs."""
        name, step = random.choice("nm"), random.randint(1, 2)
        return random.choice(
            (
                (f"(decrease ({name}) {step})", f"(>= ({name}) {step})"),
                (f"(decrease ({name}) {step})", f"(>= ({name}) {step})"),
                (f"(increase ({name}) {step})", f"(<= ({name}) {4 - step})"),
                (f"(assign ({name}) {random.randint(0, 4)})", f"({random.choice(('<', '>', '=', '>=', '<='))} ({name}) {step})"),
            )
        )

    def literal(*terms: str, true: float = 0.5, names: str = "pqr") -> str:
        fact = f"({random.choice(names)} {random.choice(terms)})"
        return fact if random.random() < true else f"(not {fact})"

    def simple(*terms: str) -> str:
        kind = random.random()
        if kind < 0.7:
            return literal(*terms, true=0.6)
        if counts and kind < 0.8:
            return f"(when (> ({random.choice('nm')}) {random.randint(0, 3)}) {literal(*terms, true=0.6)})"
        if kind < 0.9:
            return f"(when {literal(*terms, names=read)} {literal(*terms, true=0.6)})"
        return f"(forall (?y - thing) (when {literal('?y', names=read)} {literal('?y', *terms)}))"

    def effect(*terms: str) -> str:
        kind = random.random()
        if kind < 0.4:
            return simple(*terms)
        ways = [f"(and {' '.join(simple(*terms) for _ in range(random.choice((0, 1, 1, 2))))})" for _ in range(random.choice((2, 2, 3)))]
        if kind < 0.75:
            return f"(oneof {' '.join(ways)})"
        if kind < 0.9:
            return f"(probabilistic {' '.join(f'0.{number} {way}' for number, way in enumerate(ways, 2))})"
        return f"(when {literal(*terms, names=read)} (oneof {' '.join(ways)}))"

    actions = []
    for number in range(random.randint(3, 7)):
        terms = ("?x", "?x", "a", "b") if random.random() < 0.5 else ("a", "b")
        needed = [literal(*terms, names=read) for _ in range(random.choice((0, 1, 1, 2, 2)))]
        if random.random() < 0.2:
            needed.append(f"(or {literal(*terms, names=read)} {literal(*terms, names=read)})")
        effects = " ".join(effect(*terms) for _ in range(random.choice((1, 1, 2))))
        if counts and random.random() < 0.7:
            change, need = count()
            needed.append(need)
            effects += f" (oneof {change} (and))" if random.random() < 0.2 else f" {change}"
        parameters = "?x - thing" if "?x" in terms else ""
        actions.append(f"(:action a{number} :parameters ({parameters}) :precondition (and {' '.join(needed)}) :effect (and {effects}))")
    goal = random.sample(FACTS, random.choice((1, 2, 2, 3)))
    init = [fact for fact in FACTS if fact not in goal and random.random() < 0.5]
    if counts and random.random() < 0.3:
        goal.append(f"({random.choice(('>=', '<', '='))} (n) {random.randint(1, 4)})")
    rules = ""
    if derives:
        rules = RULES.format(*(literal("?x"), f"{literal('?x')} {literal('?y')}", literal("?x"), literal("?y")))
        goal = [*goal[:1], *(f"({random.choice('de')} {random.choice('ab')})" for _ in range(random.choice((0, 1, 1))))]
        goal += [f"(not (d {random.choice('ab')}))"] * (random.random() < 0.3)
    return DOMAIN.format(rules=rules, actions="\n  ".join(actions)), PROBLEM.format(init=" ".join(init), goal=" ".join(goal))


def random_problem(seed: int, *, counts: bool = False, derives: bool = False) -> Problem:
    """Return the problem of these texts."""
    domain, problem = texts(seed, counts=counts, derives=derives)
    return parse_problem(problem, parse_domain(domain))


def uncertain_problem(number: int, *, counts: bool = False) -> Problem:
    """Return the first of many random problems whose goal can be reached, over an action that has several outcomes."""
    return next(
        problem
        for seed in count(1_000 * number)
        for problem in [random_problem(seed, counts=counts)]
        for ways in [[way for every in Exact(problem).transitions.values() for way in every]]
        if any(len(way) > 1 for way in ways) and any(map(Exact(problem).is_goal, chain.from_iterable(ways)))
    )


@dataclass(frozen=True)
class Exact:
    """Every state that can be reached, and what may follow."""

    problem: Problem

    def knowledge(self, state: State) -> KnowledgeBase:
        """Return the state as knowledge."""
        return KnowledgeBase(dict(state), objects=self.problem.objects_by_type, rules=self.problem.domain.rules)

    @cached_property
    def initial(self) -> State:
        """The initial state."""
        return frozenset(initial_knowledge(self.problem).facts().items())

    def is_goal(self, state: State) -> bool:
        """Whether the goal holds."""
        return evaluate(self.problem.goal, self.knowledge(state)) is True

    def turn_outs(self, state: State, action: str, arguments: tuple[str, ...]) -> dict[State, float] | None:
        """Return the states that the action may lead to, with their chances; None if it cannot be used."""
        knowledge = self.knowledge(state)
        ground = ground_step(self.problem.domain, action, arguments, None, "", self.problem.members)
        if evaluate(ground.precondition, knowledge) is not True:
            return None
        ways = ground.outcomes or (Alternative(ground.end_effects, 1.0),)
        found: dict[State, float] = {}
        for way in ways:
            after = {**dict(state), **changes(way.effects, knowledge)}
            new = frozenset(fact for fact in after.items() if fact[1] is not False)
            found[new] = found.get(new, 0.0) + (1.0 / len(ways) if way.chance is None else way.chance)
        return found

    @cached_property
    def transitions(self) -> dict[State, list[dict[State, float]]]:
        """For every state that can be reached and is no goal, the ways to go on."""
        found: dict[State, list[dict[State, float]]] = {}
        waiting = [self.initial]
        while waiting:
            state = waiting.pop()
            if state in found or self.is_goal(state):
                continue
            found[state] = []
            for schema in self.problem.domain.actions.values():
                for arguments in product(*(self.knowledge(state).objects(variable.types) for variable in schema.parameters)):
                    way = self.turn_outs(state, schema.name, tuple(arguments))
                    if way is not None:
                        found[state].append(way)
                        waiting += way
        return found

    @property
    def has_strong_cyclic_policy(self) -> bool:
        """Whether some policy reaches the goal from the initial state as long as every outcome comes up sooner or later."""
        return self.is_goal(self.initial) or self.initial in self.certain

    @cached_property
    def certain(self) -> dict[State, list[dict[State, float]]]:
        """The states from which the goal can be reached for certain, with the ways that do not lead out of them."""
        kept = set(self.transitions)
        while True:
            safe = {
                state: [way for way in self.transitions[state] if all(after in kept or self.is_goal(after) for after in way)]
                for state in kept
            }
            reaching: set[State] = set()
            before = -1
            while len(reaching) > before:
                before = len(reaching)
                reaching |= {
                    state for state, ways in safe.items() if any(after in reaching or self.is_goal(after) for way in ways for after in way)
                }
            if reaching == kept:
                return safe
            kept = reaching

    @property
    def fewest_actions(self) -> float:
        """How many actions are expected at least if the goal is reached for certain (value iteration)."""
        costs, change = dict.fromkeys(self.certain, 0.0), 1.0
        while change > 1e-9:
            change = 0.0
            for state, ways in self.certain.items():
                value = min(1.0 + sum(p * costs.get(after, 0.0) for after, p in way.items()) for way in ways)
                change, costs[state] = max(change, abs(value - costs[state])), value
        return costs.get(self.initial, 0.0)

    @property
    def best_chance(self) -> float:
        """The chance of the goal by the best policy (value iteration)."""
        values = dict.fromkeys(self.transitions, 0.0)
        for _ in range(2_000):
            change = 0.0
            for state, ways in self.transitions.items():
                value = max((sum(p * values.get(after, 1.0) for after, p in way.items()) for way in ways), default=0.0)
                change, values[state] = max(change, abs(value - values[state])), value
            if change < 1e-12:
                break
        return values.get(self.initial, 1.0)

    def chain(self, policy: Policy, *states: State) -> dict[State, dict[State, float]]:
        """Return what may follow in every state that the policy leads to from these, but goals; nothing where it says nothing of use."""
        found: dict[State, dict[State, float]] = {}
        waiting = [*states]
        for state in waiting:
            if state not in found and not self.is_goal(state):
                entry = policy.entry(self.knowledge(state))
                found[state] = (entry and self.turn_outs(state, entry.action, entry.arguments)) or {}
                waiting += found[state]
        return found

    def played(self, policy: Policy) -> tuple[float, float, bool]:
        """Return the chance of the goal by the policy, its expected actions until it ends, and whether it ends nowhere but at the goal."""
        chain = self.chain(policy, self.initial)
        chances, costs = dict.fromkeys(chain, 0.0), dict.fromkeys(chain, 0.0)
        for _ in range(20_000):
            change = 0.0
            for state, way in chain.items():
                chance = sum(p * chances.get(after, 1.0) for after, p in way.items())
                cost = bool(way) + sum(p * costs.get(after, 0.0) for after, p in way.items())
                change = max(change, abs(chance - chances[state]), abs(cost - costs[state]))
                chances[state], costs[state] = chance, cost
            if change < 1e-12:
                break
        return chances.get(self.initial, 1.0), costs.get(self.initial, 0.0), all(chain.values())


def check_best_policy(seed: int, *, counts: bool = False, derives: bool = False) -> None:
    """Check that of a random problem the best policy is found, and proved exactly if it reaches the goal for certain."""
    problem = random_problem(seed, counts=counts, derives=derives)
    exact, every = Exact(problem), [*policies(problem, 60.0)]
    if not every:
        assert exact.best_chance == 0.0
        return
    best = every[-1]
    chance, actions, ends_at_goal = exact.played(best)
    assert chance == pytest.approx(exact.best_chance, abs=1e-5)
    assert chance == pytest.approx(best.chance, abs=1e-5)
    assert ends_at_goal is best.is_proved is exact.has_strong_cyclic_policy, unproved(problem, best.entries, initial_knowledge(problem))
    if best.is_proved and not counts and not derives:
        assert actions == pytest.approx(exact.fewest_actions, rel=0.01)
