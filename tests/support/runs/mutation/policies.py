"""Policies and their nets that were broken by edits: what is proved of one must be so when it is walked through.

The oracle of a policy walks through every state of its problem that it may come to, from wherever an entry fits; that of a net plays its
tokens by the outcomes of the steps that it stands for. Of the ways that one outcome may lead, the worst is taken.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence, Set as AbstractSet
from dataclasses import replace
from functools import partial
from itertools import product
from random import Random
from typing import Final, TypeVar

from planner_bridge.model.grounding import dynamic_names
from planner_bridge.model.problem import Problem
from planner_bridge.planning.policies.grounding import policy_task
from planner_bridge.planning.policies.net import FAILURE, PolicyNet, PolicyWay
from planner_bridge.planning.policies.policy import Policy, PolicyEntry, policies, proved_in
from planner_bridge.planning.policies.steps import GOAL, NO_WAY_OUT
from pnm.core.logic.conditions import conjunction, conjuncts
from pnm.core.logic.effects import Alternative, Effect, OneOf
from pnm.core.net.net import Marking, PetriNet, enabled, fire
from tests.support.pddl.chance import FACTS, Exact, uncertain_problem
from tests.support.runs.mutation.gate import GateReport

T = TypeVar("T")
_SECONDS: Final = 20.0
OF_STEPS: Final = ("elsewhere", "one more", "outcome lost")


def run_policy_gate(numbers: range, mutants: int = 8) -> GateReport:
    """Prove and walk through the policies of random problems, of problems that are nearly these, and mutants of both and of their nets."""
    report = GateReport()
    for number in numbers:
        random, problem = Random(number), uncertain_problem(number, counts=number % 3 == 0)
        exact, scales = Exact(problem), policy_task(problem).scales
        for title, other in (("", problem), *(nearby(problem, random) for _ in range(3))):
            *_, best = [None, *policies(other, _SECONDS)]
            if best is None:
                continue
            report.machines += 1
            kept = [entry for entry in best.entries if entry.chance == 1.0 or not best.is_proved]
            for name, entries in (("", kept), *(mutant(kept, random) for _ in range(mutants))):
                about, proved = f"policy {number} ({title}, {name})", proved_in(problem, entries, scales)
                report.judge(about, proved is not None, partial(policy_fault, exact, [entries[place] for place in proved or ()]))
            whole = PolicyNet(best.steps())
            for name, net in (("", whole), *(broken_net(whole, random) for _ in range(mutants if whole.steps else 0))):
                about = f"net {number} ({title}, {name})"
                report.judge(about, net.is_sure, partial(net_fault, net, (GOAL,)))
                report.judge(about, net.claim.startswith("proved"), partial(net_fault, net, (GOAL, FAILURE, NO_WAY_OUT)))
    return report


# --- policies ---------------------------------------------------------------------------------


def nearby(problem: Problem, random: Random) -> tuple[str, Problem]:
    """Return a problem that is nearly the same: an outcome, a need or a part of the goal less; and what was done."""
    schema = random.choice([*problem.domain.actions.values()])
    match name := random.choice(("outcome", "outcome", "need", "goal")):
        case "outcome":
            changed = replace(schema, end_effects=tuple(_with_fewer_outcomes(effect, random) for effect in schema.end_effects))
        case "need":
            changed = replace(schema, precondition=conjunction(_without(conjuncts(schema.precondition), random)))
        case _:
            return name, replace(problem, goal=conjunction(_without(conjuncts(problem.goal), random) or [problem.goal]))
    actions = {**problem.domain.actions, schema.name: changed}
    return f"{name} of {schema.name}", replace(problem, domain=replace(problem.domain, actions=actions))


def _with_fewer_outcomes(effect: Effect, random: Random) -> Effect:
    if not isinstance(effect, OneOf):
        return effect
    ways = _without(effect.alternatives, random)
    return OneOf(tuple(Alternative(way.effects, name=way.name) for way in ways))


def _without(parts: Sequence[T], random: Random) -> list[T]:
    gone = random.randrange(len(parts)) if parts else 0
    return [part for number, part in enumerate(parts) if number != gone]


def mutant(entries: Sequence[PolicyEntry], random: Random) -> tuple[str, list[PolicyEntry]]:
    """Return the entries with an edit, or two now and then, and what was done."""
    changed, done = [*entries], list[str]()
    while changed and len(done) < (2 if random.random() < 0.2 else 1):
        at, other = random.randrange(len(changed)), random.choice(changed)
        one = changed[at]
        done.append(random.choice(("lost", "weaker", "weaker", "weaker", "turned", "action", "facts", "cost", "cost", "order", "range")))
        match done[-1]:
            case "lost":
                del changed[at]
            case "weaker":
                changed[at] = one._replace(facts=dict(_without([*one.facts.items()], random)))
            case "turned":
                changed[at] = one._replace(facts={fact: value is (random.random() < 0.7) for fact, value in one.facts.items()})
            case "action":
                changed[at] = one._replace(action=other.action, arguments=other.arguments)
            case "facts":
                changed[at] = one._replace(facts=other.facts, numbers=other.numbers)
            case "cost":
                changed[at] = one._replace(expected=random.choice((0.0, 0.5, other.expected, one.expected + 1.0, one.expected / 2)))
            case "order":
                changed[at], changed[number] = changed[number := changed.index(other)], one
            case "range":
                changed[at] = one._replace(numbers=dict(_without([*one.numbers.items()], random)))
    return " + ".join(done), changed


def policy_fault(exact: Exact, entries: Sequence[PolicyEntry]) -> str:
    """Return what goes wrong from a state in which an entry fits, or from the initial one; empty when nothing does."""
    policy, changing = Policy(exact.problem, tuple(entries)), dynamic_names(exact.problem)
    facts = [fluent for text in FACTS if (fluent := tuple(text.strip("()").split()))[0] in changing]
    kept = {fluent: value for fluent, value in exact.initial if fluent not in facts}
    every = (frozenset({**kept, **dict.fromkeys(filter(None, true), True)}.items()) for true in product(*((None, fact) for fact in facts)))
    chain = exact.chain(policy, exact.initial, *(state for state in every if policy.entry(exact.knowledge(state))))
    if stuck := [state for state, after in chain.items() if not after]:
        return f"it leads no further in {sorted(fluent for fluent, _ in stuck[0])}"
    return "" if all_end({state: [{after} for after in ways] for state, ways in chain.items()}) else "it goes round for ever"


# --- nets -------------------------------------------------------------------------------------


def broken_net(net: PolicyNet, random: Random) -> tuple[str, PolicyNet]:
    """Return a net with an edit, of its steps, or behind their back of its arcs, of what these stand for, or of the distances."""
    steps, petri, ways = [*net.steps], net.net, dict(net.ways)
    inputs, outputs, numbers = dict(petri.inputs), dict(petri.outputs), [GOAL, NO_WAY_OUT, *(step.number for step in steps)]
    name, place, to = random.choice(petri.transitions), random.choice(petri.places), random.choice(numbers)
    step = steps[at := random.randrange(len(steps))]
    branches = [*step.branches]
    branch = random.randrange(len(branches))
    edit = random.choice((*OF_STEPS, *OF_STEPS, "arc", "arc", "arc", "from", "transition lost", "stands for", "distance"))
    match edit:
        case "elsewhere":
            branches[branch] = branches[branch]._replace(then=(to,))
        case "one more":
            branches[branch] = branches[branch]._replace(then=(*{*branches[branch].then, to},))
        case "outcome lost":
            del branches[branch]
        case "arc":
            outputs[name] = random.choice(({place: 1}, {place: 1}, {}, {**outputs[name], place: 1}))
        case "from":
            inputs[name] = random.choice(({place: 1}, {}, {**inputs[name], place: 1}))
        case "transition lost":
            del inputs[name], outputs[name], ways[name]
        case "stands for":
            other = random.choice(petri.transitions)
            ways[name], ways[other] = ways[other], ways[name]
    if edit in OF_STEPS:
        steps[at] = step._replace(branches=tuple(branches))
        return edit, PolicyNet(steps)
    changed = PolicyNet(steps)
    vars(changed)["_built"] = PetriNet(petri.places, inputs, outputs), ways
    if edit == "distance":
        wrong = {number: random.randrange(5) for number in numbers if number != NO_WAY_OUT or NO_WAY_OUT in net.places}
        vars(changed)["distances"] = lambda ends: wrong
    return edit, changed


def net_fault(net: PolicyNet, ends: Collection[int]) -> str:
    """Return what goes wrong when the net follows the outcomes, or a call fails if failure is an end; empty when nothing does."""
    finals = {Marking([net.places[end]]) for end in ends if end in net.places}
    found: dict[Marking, list[set[Marking]]] = {}
    waiting = [net.initial]
    for marking in waiting:
        if marking in found or marking in finals:
            continue
        if [*marking.values()] != [1] or (step := next((one for one in net.steps if marking[net.places[one.number]]), None)) is None:
            return f"it comes to {marking}"
        possible = [(net.ways[name], fire(net.net, marking, name)) for name in enabled(net.net, marking)]
        ways = [way for way in PolicyWay.all_from(step) if FAILURE in ends or way.outcome]
        follow = {way: {after for other, after in possible if other == way} for way in ways}
        if lost := [way.outcome for way, after in follow.items() if not after]:
            return f"nothing takes the outcome {lost[0]!r} of #{step.number}"
        found[marking] = [after for way, after in follow.items() if way.outcome]
        waiting += [one for after in follow.values() for one in after]
    return "" if all_end(found) else "it goes round for ever"


def all_end(follow: Mapping[T, Iterable[AbstractSet[T]]]) -> bool:
    """Whether it comes to an end from every state with luck: all of one of the sets that may follow leads there, or nearer."""
    over = set[T]()
    while near := {
        state
        for state, ways in follow.items()
        if state not in over and any(all(after in over or after not in follow for after in way) for way in ways)
    }:
        over |= near
    return len(over) == len(follow)
