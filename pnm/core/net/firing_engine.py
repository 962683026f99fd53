"""The firing rule over integers, in time proportional to the arcs of the transition that fires.

A transition that takes one token from one place is enabled when that place is marked; every other keeps the number of
input places that do not yet hold enough tokens. Firing touches only the neighbours of the places it changes,
so the cost of a firing does not grow with the net. `pnm.core.net.firing_rule` is the readable version.
"""

from __future__ import annotations

from collections.abc import Mapping

from pnm.core.net.net import Marking, PetriNet
from pnm.errors import NotEnabled


class CompiledNet:
    """A net as adjacency lists over ids; shared by any number of engines."""

    def __init__(self, net: PetriNet) -> None:
        self.net = net
        self.place_id = {place: index for index, place in enumerate(net.places)}
        self.transitions = net.transitions
        self.transition_id = {transition: index for index, transition in enumerate(self.transitions)}
        ids = self.place_id
        self.inputs = [[(ids[place], weight) for place, weight in net.inputs[transition].items()] for transition in self.transitions]
        self.outputs = [[(ids[place], weight) for place, weight in net.outputs[transition].items()] for transition in self.transitions]
        # Only consumers are indexed: a change of tokens can enable or disable nothing else.
        self.consumers: list[list[tuple[int, int]]] = [[] for _ in net.places]
        for transition, inputs in enumerate(self.inputs):
            for place, weight in inputs:
                self.consumers[place].append((transition, weight))
        self.only_input = [inputs[0][0] if len(inputs) == 1 and inputs[0][1] == 1 else None for inputs in self.inputs]
        """For every transition that takes one token, its place."""
        self.joins = [[(one, weight) for one, weight in consumers if self.only_input[one] is None] for consumers in self.consumers]
        """For every place, the consumers that take more than one token."""
        # A place that is both input and output is first emptied and then filled: each change is small and keeps `missing` exact.
        changes = [
            [*((place, -weight) for place, weight in inputs), *outputs] for inputs, outputs in zip(self.inputs, self.outputs, strict=True)
        ]
        self.moves = [[(place, change) for place, change in all_ if not self.joins[place]] for all_ in changes]
        """For every transition, how it changes the places that no consumer counts."""
        self.counted = [[(place, change) for place, change in all_ if self.joins[place]] for all_ in changes]
        """For every transition, how it changes those that some consumer counts."""
        # Every input place counts as lacking at first; an initial marking is added like any other tokens.
        self.unmarked = [0 if only is not None else len(inputs) for only, inputs in zip(self.only_input, self.inputs, strict=True)]
        """For every transition that takes more than one token, how many places hold too little when none is marked."""


class Engine:
    """A net and its current marking.

    The mutable state is `tokens`, per place, and `missing`, per transition the number of places that hold too little; it stays at 0 for
    those that take one token.
    """

    def __init__(self, compiled: CompiledNet, marking: Mapping[str, int]) -> None:
        self.compiled = compiled
        self.tokens = [0] * len(compiled.place_id)
        self.missing = compiled.unmarked.copy()
        for place, count in marking.items():
            self._add(compiled.place_id[place], count)

    def is_enabled(self, transition: int) -> bool:
        """Return whether the marking covers the transition's preset."""
        only = self.compiled.only_input[transition]
        return self.missing[transition] == 0 if only is None else self.tokens[only] > 0

    def lacking(self, transition: int) -> set[int]:
        """Return the places of the transition's preset that do not hold enough tokens."""
        return {place for place, weight in self.compiled.inputs[transition] if self.tokens[place] < weight}

    def fire(self, transition: int, times: int = 1) -> None:
        """Fire the transition `times` at once; raise `NotEnabled`, and change nothing, if the marking does not cover the preset."""
        compiled, tokens = self.compiled, self.tokens
        only = compiled.only_input[transition]
        # Checked before any token moves, so that a refused firing leaves the marking as it was.
        # `missing` counts places for a single firing only; several at once need the weights to be looked at.
        if times > 1 or (self.missing[transition] if only is None else not tokens[only]):
            inputs, places = compiled.inputs[transition], compiled.net.places
            short = {places[place]: weight * times - tokens[place] for place, weight in inputs if tokens[place] < weight * times}
            if short:
                raise NotEnabled(compiled.transitions[transition], short)
        for place, change in compiled.moves[transition]:
            tokens[place] += change * times
        for place, change in compiled.counted[transition]:
            self._add(place, change * times)

    def _add(self, place: int, count: int) -> None:
        missing, before = self.missing, self.tokens[place]
        after = self.tokens[place] = before + count
        for transition, weight in self.compiled.joins[place]:
            # Only a change across the weight matters: the place begins, or ceases, to be covered for this consumer.
            if before < weight <= after:
                missing[transition] -= 1
            elif after < weight <= before:
                missing[transition] += 1

    def marking(self) -> Marking:
        """Return the current marking."""
        return Marking(dict(zip(self.compiled.net.places, self.tokens, strict=True)))
