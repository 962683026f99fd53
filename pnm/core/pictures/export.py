"""Machines written in other formats. Pure functions; the same machine gives the same bytes.

Machines as Graphviz text: places round, transitions square, one frame per step, around what it holds. Byte-stable.

Machines as JSON: places with their roles, transitions with δ̂, arcs, initial marking. Byte-stable.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from enum import Enum
from typing import Any

from pnm.core.machine.guards import Guard
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, PlanEvent, Step, flows
from pnm.errors import printable_lines

COLOURS = {
    "goal": "#2e7d32",
    "failure": "#c62828",
    "restart": "#ef6c00",
    "budget": "#f9a825",
    "resource": "#6a1b9a",
    "ordering": "#1565c0",
    "": "#455a64",
}
"""Of places, by their roles."""

_DOTS = 5
"""Tokens that are drawn as dots; more are counted."""


def to_dot(machine: PetriNetMachine) -> str:
    """Return the machine as a directed graph."""
    lines = ["digraph machine {", '  rankdir=LR; node [fontname="sans-serif", fontsize=10];']
    transitions: dict[int | None, list[str]] = {}
    for name, rule in machine.rules.items():
        transitions.setdefault(rule.call, []).append(name)
    for step in machine.plan.steps:
        lines += _cluster(machine, step, transitions, "  ")
    inside = {place for places in machine.blocks.values() for place in places}
    inside |= {place for region in machine.regions if region.owner is not None for place in (*region.first, *region.last)}
    lines += (f"  {_place(machine, place)}" for place in machine.net.places if place not in inside)
    lines += (f"  {_transition(machine, name)}" for name in transitions[None])
    for arc in machine.net.arcs:
        weight = f" [label={arc.weight}]" if arc.weight > 1 else ""
        # A cycle would make Graphviz place what comes later first.
        back = " [constraint=false]" if (arc.source, arc.target) in machine.time_order.back else ""
        lines.append(f"  {quoted(arc.source)} -> {quoted(arc.target)}{weight}{back};")
    return "\n".join((*lines, "}", ""))


def _cluster(machine: PetriNetMachine, step: Step, transitions: Mapping[int | None, list[str]], indent: str) -> Iterator[str]:
    yield f'{indent}subgraph cluster_{step.index} {{ label={quoted(str(step))}; color=gray; fontname="sans-serif";'
    when = machine.time_order.when
    nodes = {place: (when[place], 0) for place in machine.blocks[step.index]}
    for name in transitions[step.index]:
        nodes[name] = max((nodes[place][0] for place in machine.net.inputs[name] if place in nodes), default=-1), 1
    for node in sorted(nodes, key=nodes.__getitem__):  # Graphviz places first what stands first
        yield f"{indent}  {_transition(machine, node) if node in machine.rules else _place(machine, node, f'{step} ')}"
    held = (region for region in machine.regions if region.owner == step.index)
    inner_places = dict.fromkeys(place for region in held for place in (*region.first, *region.last))
    yield from (f"{indent}  {_place(machine, place)}" for place in inner_places)
    for flow in flows(step):
        for inner in flow.steps:
            yield from _cluster(machine, inner, transitions, f"{indent}  ")
    yield f"{indent}}}"


def _place(machine: PetriNetMachine, place: str, title: str = "") -> str:
    label = place.removeprefix(title)
    if place in machine.orderings:
        label = ", ".join(map(" ".join, machine.orderings[place].protects))
    elif place in machine.border_places:
        label = ""  # its arcs say which steps it connects
    tokens = machine.initial[place]
    label += " •" * tokens if tokens <= _DOTS else f" {tokens}"
    return f"{quoted(place)} [shape=circle, label={quoted(label)}, color={quoted(COLOURS[machine.role(place)])}];"


def _transition(machine: PetriNetMachine, name: str) -> str:
    return f"{quoted(name)} [shape=box, height=0.2, label={quoted(machine.rules[name].name)}];"


def quoted(text: str) -> str:
    """Return a text as Graphviz reads it."""
    return '"' + printable_lines(text).replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'


def to_json(machine: PetriNetMachine) -> str:
    """Return the machine as one JSON object."""
    return json.dumps(as_data(machine), indent=1) + "\n"


def as_data(machine: PetriNetMachine) -> dict[str, Any]:
    """Return the machine as plain data."""
    return {
        "calls": [{"name": str(call), "action": call.action.name, "arguments": list(call.action.arguments)} for call in machine.plan.calls],
        "steps": [{"number": step.index, "name": str(step)} for step in machine.plan.every_step if not isinstance(step, ActionCall)],
        "orderings": [
            {"before": str(ordering.before), "after": str(ordering.after), "protects": [" ".join(fluent) for fluent in ordering.protects]}
            for ordering in machine.orderings.values()
        ],
        "places": [{"name": place, "role": machine.role(place), "tokens": machine.initial[place]} for place in machine.net.places],
        "transitions": [
            {
                "name": name,
                "event": rule.name,
                "call": rule.call,
                "guard": guard_data(rule.guard),
                "action": rule.action.name if rule.action else None,
            }
            for name, rule in machine.rules.items()
        ],
        "arcs": [{"source": arc.source, "target": arc.target, "weight": arc.weight} for arc in machine.net.arcs],
        "goal_places": sorted(machine.goal_places),
    }


def certified(machine: PetriNetMachine) -> dict[str, Any]:
    """Return all that the proof of a machine is about, as `check_certificate.py` proves it again from this alone."""
    data, kept = as_data(machine), {ordering: place for place, ordering in machine.orderings.items()}
    for place in data["places"]:
        place["role"] = "failure mark" if place["name"] in machine.failure_places else place["role"]
    for transition in data["transitions"]:
        transition["gives_up"] = machine.rules[transition["name"]].gives_up
    every_flow = (machine.plan.flow, *(flow for step in machine.plan.every_step for flow in flows(step)))
    orderings = [one for flow in every_flow for one in flow.orderings]

    def event(of: PlanEvent) -> list[object]:
        return [of.call, of.moment.value]

    return {
        "steps": [{"number": step.index, "name": str(step)} for step in machine.plan.every_step],
        "orderings": [
            {
                "before": event(one.before),
                "after": event(one.after),
                "protects": [" ".join(fluent) for fluent in one.protects],
                "delay": one.delay,
                "place": kept.get(one),
            }
            for one in orderings
        ],
        "goal": str(machine.plan.goal),
        "goal_place": machine.goal_place,
        "failed_place": machine.failed_place,
        "regions": [
            {"owner": one.owner, "steps": sorted(one.steps), "first": [*one.first], "last": [*one.last]} for one in machine.regions
        ],
        **{key: data[key] for key in ("calls", "places", "transitions", "arcs")},
    }


def guard_data(guard: Guard) -> dict[str, Any]:
    """Return a guard as plain data: its kind, and what it asks about."""
    data: dict[str, Any] = {"kind": type(guard).__name__}
    for field in fields(guard):
        value = getattr(guard, field.name)
        data[field.name] = (
            sorted(kind.value for kind in value)
            if isinstance(value, frozenset)
            else value
            if isinstance(value, int | float)
            else value.name
            if isinstance(value, Enum)
            else str(value)
        )
    return data
