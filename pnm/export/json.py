"""Machines as JSON: places with their roles, transitions with δ̂, arcs, initial marking. Byte-stable."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

from pnm.machine import Guard, PetriNetMachine
from pnm.plan_graph import ActionCall


def to_json(machine: PetriNetMachine) -> str:
    """Return the machine as one JSON object."""
    return json.dumps(as_data(machine), indent=1, ensure_ascii=False) + "\n"


def as_data(machine: PetriNetMachine) -> dict[str, Any]:
    """Return the machine as plain data."""
    return {
        "calls": [{"name": str(call), "action": call.action.name, "arguments": list(call.action.arguments)} for call in machine.plan.calls],
        "steps": [{"number": step.index, "name": str(step)} for step in machine.plan.every_step if not isinstance(step, ActionCall)],
        "orderings": [
            {"before": str(one.before), "after": str(one.after), "protects": [" ".join(fluent) for fluent in one.protects]}
            for one in machine.orderings.values()
        ],
        "places": [{"name": place, "role": machine.role(place), "tokens": machine.initial[place]} for place in machine.net.places],
        "transitions": [
            {
                "name": name,
                "event": rule.name,
                "call": rule.call,
                "guard": _guard(rule.guard),
                "deed": rule.deed.name if rule.deed else None,
            }
            for name, rule in machine.rules.items()
        ],
        "arcs": [{"source": arc.source, "target": arc.target, "weight": arc.weight} for arc in machine.net.arcs],
        "goal_places": sorted(machine.goal_places),
    }


def _guard(guard: Guard) -> dict[str, Any]:
    found: dict[str, Any] = {"kind": type(guard).__name__}
    for one in fields(guard):
        value = getattr(guard, one.name)
        found[one.name] = (
            sorted(kind.value for kind in value)
            if isinstance(value, frozenset)
            else value
            if isinstance(value, int | float)
            else str(value)
        )
    return found
