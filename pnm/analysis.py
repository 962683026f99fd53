"""Nets, plans and policies for notebooks: as arrays of numpy, as graphs of networkx. Needs the extra `analysis`.

The *incidence matrix* C has a row for each place and a column for each transition: the tokens that its firing adds. The *state equation*
m' = m + C·x says which marking follows when each transition has fired as often as the vector x says.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias

from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, PlanGraph, flows, necessary, step_words
from pnm.core.net.net import Marking, PetriNet
from pnm.core.pictures.export import as_data
from pnm.core.pictures.pnml import PnmlNet, read_pnml as pnml_in
from pnm.errors import InputError, not_installed
from pnm.files.text import read_text

try:
    import networkx as nx
    import numpy as np
    from numpy.typing import NDArray
except ImportError as missing:
    raise ImportError(not_installed("pnm.analysis", missing, "analysis").message) from missing

Array: TypeAlias = NDArray[np.int64]

MAX_BYTES: Final = 100_000_000
"""Of a file with a net."""
MAX_CELLS: Final = 10**8
"""Of an array: it takes 800 MB."""


@dataclass(frozen=True, eq=False)
class NetArrays:
    """A net as arrays: rows are places, columns are transitions, in their order in the net."""

    places: tuple[str, ...]
    transitions: tuple[str, ...]
    takes: Array
    """Weights of the arcs from places to transitions."""
    gives: Array
    """Weights of the arcs from transitions to places."""
    initial: Array
    """The marking at first."""

    @property
    def incidence(self) -> Array:
        """C, the tokens that each transition adds to each place."""
        return self.gives - self.takes

    @cached_property
    def column(self) -> Mapping[str, int]:
        """The column of each transition."""
        return {name: number for number, name in enumerate(self.transitions)}

    def vector(self, marking: Mapping[str, int]) -> Array:
        """Return a marking as a vector."""
        return np.array([marking.get(place, 0) for place in self.places], dtype=np.int64)

    def marking(self, vector: Iterable[int]) -> Marking:
        """Return a vector as a marking."""
        return Marking({place: int(tokens) for place, tokens in zip(self.places, vector, strict=True)})

    def counts(self, fired: Iterable[str]) -> Array:
        """Return x, how often each transition is among those that have fired."""
        counts = np.zeros(len(self.transitions), dtype=np.int64)
        for name in fired:
            counts[self.column[name]] += 1
        return counts

    def after(self, counts: Array, marking: Array | None = None) -> Array:
        """Return m + C·x, from the first marking if no other is given.

        No firing sequence need exist that has these counts: where an entry is negative, there is none.
        """
        return (self.initial if marking is None else marking) + self.incidence @ counts

    def enabled(self, marking: Array) -> tuple[str, ...]:
        """Return the enabled transitions."""
        return tuple([self.transitions[column] for column in np.flatnonzero(np.all(self.takes <= marking[:, None], axis=0))])


def arrays(of: PetriNetMachine | PnmlNet | PetriNet) -> NetArrays:
    """Return a net as arrays; one without a marking begins empty. Raise `InputError` if they would have more than `MAX_CELLS` each."""
    net, initial = (of, Marking()) if isinstance(of, PetriNet) else (of.net, of.initial)
    number, shape = net.place_numbers, (len(net.places), len(net.transitions))
    if shape[0] * shape[1] > MAX_CELLS:
        raise InputError(f"{shape[0]} places and {shape[1]} transitions; expected an array of {MAX_CELLS} cells at most")
    takes, gives = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    for column, name in enumerate(net.transitions):
        for matrix, weights in ((takes, net.inputs[name]), (gives, net.outputs[name])):
            for place, weight in weights.items():
                matrix[number[place], column] = weight
    return NetArrays(tuple(net.places), net.transitions, takes, gives, np.array([initial[place] for place in net.places], dtype=np.int64))


class HasData(Protocol):
    """A net that is exported as those of machines are, such as that of a policy."""

    def as_data(self) -> dict[str, Any]:
        """Return it as plain data."""


def to_networkx(of: PlanGraph | PetriNetMachine | HasData) -> nx.MultiDiGraph:
    """Return a plan or a net as a graph.

    Of a plan: a node for each step, by its number, an edge for each ordering that does not follow from others; steps that hold others are
    in `held_by`. Of a machine, or the `PolicyNet` of a policy: a node for each place and each transition, by its name, told apart by
    `kind`, and an edge for each arc. What is known of them are attributes.
    """
    graph = nx.MultiDiGraph()
    if isinstance(of, PlanGraph):
        held = {inner.index: step.index for step in of.every_step for flow in flows(step) for inner in flow.steps}
        for step in of.every_step:
            about: dict[str, Any] = {"name": step_words(step), "kind": type(step).__name__, "held_by": held.get(step.index)}
            if isinstance(step, ActionCall):
                about |= {"action": step.action.name, "arguments": step.action.arguments, "planned": step.planned}
            graph.add_node(step.index, **about)
        for flow in (of.flow, *(flow for step in of.every_step for flow in flows(step))):
            for one in necessary(flow):
                events = {"before": one.before.moment.value, "after": one.after.moment.value}
                graph.add_edge(one.before.call, one.after.call, **events, protects=one.protects, delay=one.delay)
        return graph
    data = as_data(of) if isinstance(of, PetriNetMachine) else of.as_data()
    for kind in ("place", "transition"):
        for node in data[f"{kind}s"]:
            graph.add_node(node["name"], kind=kind, **{key: value for key, value in node.items() if key != "name"})
    for arc in data["arcs"]:
        graph.add_edge(arc["source"], arc["target"], weight=arc["weight"])
    return graph


def read_pnml(file: Path | str) -> PnmlNet:
    """Read a place/transition net from a file in PNML; raise `InputError`, with line and column, if it is none."""
    return pnml_in(read_text(file, MAX_BYTES), str(file))
