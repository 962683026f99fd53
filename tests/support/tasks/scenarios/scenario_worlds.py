"""Worlds for random scripts: what may be wanted there, which plans may be sent, and what may change by itself."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations

from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import load
from pnm.core.logic.effects import Alternative, Effects, OneOf
from pnm.core.logic.expressions import Fluent, Value
from tests.support.files import ROOT
from tests.support.pddl.problems import fleet, matches, rooms, tanks

Choose = Callable[[random.Random], str]


@dataclass(frozen=True)
class ScenarioWorld:
    """A world, what robots there have for themselves, and what may be wanted and happen in it."""

    problem: Problem
    resources: Mapping[str, tuple[str, ...]]
    goal: Choose
    plan: Choose
    change: Callable[[random.Random], Mapping[Fluent, Value]]


def _fleet_plan(rng: random.Random) -> str:
    r, p, a, b = f"r{rng.randrange(3)}", f"p{rng.randrange(4)}", (n := rng.randrange(4)), (n + rng.choice([1, 3])) % 4
    return rng.choice([f"(move {r} a{a} a{b})\n(move {r} a{b} a{a})", f"(pick {r} {p} a{a})\n(drop {r} {p} a{a})", f"(move {r} a{a} a{b})"])


def _fleet_goal(rng: random.Random) -> str:
    one = f"(in p{rng.randrange(4)} a{rng.randrange(4)})"
    other = f"(at r{rng.randrange(3)} a{rng.randrange(4)})"
    return rng.choice([one, one, other, f"(and {one} {other})", f"(not {other})", f"(or {one} {other})"])


def _fleet_change(rng: random.Random) -> Mapping[Fluent, Value]:
    r, a, b = f"r{rng.randrange(3)}", f"a{rng.randrange(4)}", f"a{rng.randrange(4)}"
    moved = {("at", r, f"a{n}"): f"a{n}" == a for n in range(4)}
    return rng.choice([moved, {("way", a, b): rng.random() < 0.5}, {("in", f"p{rng.randrange(4)}", a): True}])


def _rooms_goal(rng: random.Random) -> str:
    one, other = f"(clean {rng.choice('abcd')})", f"(at r{rng.choice('12')} {rng.choice('abcd')})"
    return rng.choice([one, other, f"(and {one} {other})", f"(not {other})"])


def _rooms_plan(rng: random.Random) -> str:
    return rng.choice(["(move r1 a b)\n(sweep r1 b)", "(sweep r2 a)", "(move r2 a d)\n(move r2 d c)"])


def _rooms_change(rng: random.Random) -> Mapping[Fluent, Value]:
    a, b = rng.choice([*permutations("abcd", 2)])
    return rng.choice(
        [{("way", a, b): rng.random() < 0.7}, {("clean", a): rng.random() < 0.5}, {("at", "r1", a): True, ("at", "r1", b): False}]
    )


def _matches_goal(rng: random.Random) -> str:
    return rng.choice([f"(mended f{rng.randrange(5)})", f"(and (mended f{rng.randrange(5)}) (mended f{rng.randrange(5)}))"])


def _matches_change(rng: random.Random) -> Mapping[Fluent, Value]:
    n = rng.randrange(5)
    return rng.choice(
        [{("light", f"m{n}"): False}, {("unused", f"m{n}"): True}, {("free",): rng.random() < 0.8}, {("mended", f"f{n}"): True}]
    )


def _tanks_goal(rng: random.Random) -> str:
    return rng.choice([f"(>= (level {rng.choice('ab')}) {rng.choice([2, 4, 6])})", f"(open {rng.choice('ab')})", "(= (level b) 4)"])


def _tanks_change(rng: random.Random) -> Mapping[Fluent, Value]:
    return rng.choice([{("level", rng.choice("ab")): float(rng.randrange(9))}, {("open", rng.choice("ab")): False}])


_PLACES = ["store", "yard", "hall", "corridor", "kitchen"]


def _delivery_goal(rng: random.Random) -> str:
    one = f"(at parcel{rng.choice('12')} {rng.choice(['hall', 'kitchen'])})"
    other = f"(at r{rng.choice('12')} {rng.choice(_PLACES)})"
    return rng.choice([one, one, other, f"(and {one} {other})", "(open door1)"])


def _delivery_change(rng: random.Random) -> Mapping[Fluent, Value]:
    a, b = rng.choice([("hall", "kitchen"), ("store", "hall"), ("hall", "store"), ("yard", "hall")])
    return rng.choice(
        [{("open", "door1"): rng.random() < 0.5}, {("connected", a, b): rng.random() < 0.6}, {("at", "parcel1", "hall"): True}]
    )


@cache
def scenario_worlds() -> tuple[ScenarioWorld, ...]:
    folder = ROOT / "problems" / "delivery"
    delivery = load(ROOT / "domains" / "delivery" / "domain.pddl", folder / "p01.pddl")
    robots = dict.fromkeys(delivery.domain.actions, ("{robot}",))
    robots["load"] = ("{robot}", "lift")
    return (
        ScenarioWorld(fleet(3), dict.fromkeys(("move", "pick", "drop"), ("{r}",)), _fleet_goal, _fleet_plan, _fleet_change),
        ScenarioWorld(fleet(3), {"move": ("{r}",), "pick": ("{r}", "lift"), "drop": ("lift",)}, _fleet_goal, _fleet_plan, _fleet_change),
        ScenarioWorld(rooms(), {"move": ("{r}", "floor"), "sweep": ("floor",)}, _rooms_goal, _rooms_plan, _rooms_change),
        ScenarioWorld(
            matches(5),
            {"mend": ("hand",)},
            _matches_goal,
            lambda rng: f"0: (strike m{rng.randrange(5)}) [8]\n1: (mend f{rng.randrange(5)} m{rng.randrange(5)}) [5]",
            _matches_change,
        ),
        ScenarioWorld(tanks("8"), {"pour": ("{from}", "{to}")}, _tanks_goal, lambda rng: "(unlock b)\n(pour a b)", _tanks_change),
        ScenarioWorld(delivery, robots, _delivery_goal, lambda rng: "(move r1 store hall)\n(move r1 hall store)", _delivery_change),
    )


def uncertain(world: ScenarioWorld) -> ScenarioWorld:
    """The same world, in which actions that change nothing at their start may also turn out to have done nothing."""
    domain = world.problem.domain

    def ways(effects: Effects) -> Effects:
        return (OneOf((Alternative(effects, name="done"), Alternative(name="nothing"))),)

    found = {name: one if one.start_effects else replace(one, end_effects=ways(one.end_effects)) for name, one in domain.actions.items()}
    return replace(world, problem=replace(world.problem, domain=replace(domain, actions=found)))
