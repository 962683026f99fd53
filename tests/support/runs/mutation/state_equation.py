"""A second opinion on soundness: z3 on the state equation of a machine's net, which every reachable marking satisfies.

A marking that is wrong and cannot be excluded so need not be reachable; one that is excluded is not. For the net of a policy z3 looks for
the steps that count and for their distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import combinations
from typing import Any, Final

import z3

from planner_bridge.planning.policies.steps import GOAL, Step
from pnm.core.machine.guards import Always, ConditionFalse, ConditionTrue, EffectsMissing, EffectsSeen, Ending, Failing, Opener
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Weights

QUESTIONS: Final = ("a hang", "a bad end", "an early end")


class StateEquation:
    """The markings that the state equation allows: the first one, and what any number of firings adds and takes."""

    def __init__(self, machine: PetriNetMachine) -> None:
        net = machine.net
        self.machine = machine
        self.tokens = {place: z3.Int(f"m{number}") for number, place in enumerate(net.places)}
        fired = {name: z3.Int(f"x{number}") for number, name in enumerate(net.transitions)}
        flow: dict[str, list[Any]] = {place: [machine.initial[place]] for place in net.places}
        for name, times in fired.items():
            for place in {*net.inputs[name], *net.outputs[name]}:
                gain = net.outputs[name].get(place, 0) - net.inputs[name].get(place, 0)
                if gain:
                    flow[place].append(gain * times)
        self.solver = z3.SolverFor("QF_LIA")
        self.solver.add([times >= 0 for times in fired.values()])
        self.solver.add([tokens >= 0 for tokens in self.tokens.values()])
        self.solver.add([tokens == reduce(lambda one, other: one + other, flow[place]) for place, tokens in self.tokens.items()])
        self.ends = self.tokens[machine.goal_place] + self.tokens[machine.failed_place]
        others = [
            self.tokens[place] for place in net.places if place not in {machine.goal_place, machine.failed_place, *machine.record_places}
        ]
        self.others = z3.Sum(others)

    def excludes(self, question: str) -> bool:
        """Return whether no marking that the equation allows is such."""
        self.solver.push()
        self.solver.add(*self._wrong(question))
        verdict = self.solver.check()
        self.solver.pop()
        return bool(verdict == z3.unsat)

    def _wrong(self, question: str) -> list[Any]:
        if question == "an early end":
            return [z3.Or(self.ends > 1, z3.And(self.ends == 1, self.others > 0))]
        improper = z3.Or(self.ends != 1, self.others > 0)
        enabled = {name: self._enabled(inputs) for name, inputs in self.machine.net.inputs.items()}
        if question == "a bad end":
            return [improper, *(z3.Not(one) for one in enabled.values())]
        return [improper, *(z3.Not(one) for one in self._sure(enabled))]

    def _enabled(self, inputs: Weights) -> Any:
        return z3.And([self.tokens[place] >= weight for place, weight in inputs.items()])

    def _sure(self, enabled: dict[str, Any]) -> list[Any]:
        """Return what is sure to happen: whatever the world answers, in finite time."""
        failing = (
            z3.Sum([self.tokens[place] for place in (*self.machine.failure_places, *self.machine.restart_places)] or [z3.IntVal(0)]) > 0
        )
        sure, asked = [], dict[object, list[tuple[object, Any]]]()
        for name, rule in self.machine.rules.items():
            match rule.guard:
                case Always():
                    sure.append(enabled[name])
                case Ending() | Failing():
                    sure.append(z3.And(failing, enabled[name]))
                case ConditionTrue(condition) | ConditionFalse(condition):
                    asked.setdefault((rule.call, condition), []).append((type(rule.guard), enabled[name]))
                case EffectsSeen() | EffectsMissing():
                    asked.setdefault(rule.call, []).append((type(rule.guard), enabled[name]))
                case guard if guard.opened_by is Opener.TIME and guard.is_sure:
                    sure.append(enabled[name])
                case _:
                    pass
        both = (
            z3.And(one, other)
            for answers in asked.values()
            for (kind, one), (other_kind, other) in combinations(answers, 2)
            if kind is not other_kind
        )
        return [*sure, *both]


def has_distances(steps: Sequence[Step]) -> bool:
    """Return whether some steps of a policy, and the first, lead to each other and the goal alone, one outcome of each nearer to it."""
    solver, counting = z3.Solver(), {GOAL: z3.BoolVal(True)} | {step.number: z3.Bool(f"is{step.number}") for step in steps}
    distances = {GOAL: z3.IntVal(0)} | {step.number: z3.Int(f"d{step.number}") for step in steps}
    solver.add(counting[steps[0].number if steps else GOAL])
    for step in steps:
        ways = [[number in counting and z3.And(counting[number], distances[number] >= 0) for number in one.then] for one in step.branches]
        nearer = [[number in counting and distances[number] < distances[step.number] for number in one.then] for one in step.branches]
        solver.add(z3.Implies(counting[step.number], z3.And(*map(z3.And, ways), z3.Or(*map(z3.And, nearer)))))
    return bool(solver.check() == z3.sat)
