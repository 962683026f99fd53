"""Firing: the rule, and the engine that fires a net by number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pnm.core.net.block_net import BlockNet
from pnm.core.net.net import Marking, PetriNet
from pnm.errors import NotEnabled


def is_enabled(net: PetriNet, marking: Marking, transition: str, times: int = 1) -> bool:
    """Return whether the marking covers the transition's preset, `times` over."""
    return marking.covers(net.inputs[transition], times)


def enabled(net: PetriNet, marking: Marking) -> tuple[str, ...]:
    """Return the enabled transitions, in the net's order."""
    return tuple(transition for transition in net.inputs if is_enabled(net, marking, transition))


def fire(net: PetriNet, marking: Marking, transition: str, times: int = 1) -> Marking:
    """Return the marking after the transition has fired `times` at once: m' = T̄·D + m.

    Raises:
        NotEnabled: the marking does not cover the preset; nothing has changed.
    """
    inputs, outputs = net.inputs[transition], net.outputs[transition]
    missing = {place: weight * times - marking[place] for place, weight in inputs.items() if marking[place] < weight * times}
    if missing:  # the whole preset is checked before anything is taken: a firing is atomic
        raise NotEnabled(transition, missing)
    tokens = dict(marking)
    for place, weight in inputs.items():
        tokens[place] -= weight * times
    for place, weight in outputs.items():
        tokens[place] = tokens.get(place, 0) + weight * times
    return Marking(tokens)


class Engine:
    """A net and its current marking.

    The mutable state is `tokens`, per place, and `missing`, per transition the number of places that hold too little; it stays at 0 for
    those that take one token.
    """

    def __init__(self, net: BlockNet[Any], marking: Mapping[int, int]) -> None:
        self.net, self._counted, self._joins = net, net.counted, net.joins
        self.tokens = [0] * net.count_places
        self.missing = net.unmarked.copy()
        # An initial marking is added like any other tokens.
        for place, count in marking.items():
            self._add(place, count)

    def is_enabled(self, transition: int) -> bool:
        """Return whether the marking covers the transition's preset."""
        only = self.net.only_input[transition]
        return self.missing[transition] == 0 if only is None else self.tokens[only] > 0

    def lacking(self, transition: int) -> set[int]:
        """Return the places of the transition's preset that do not hold enough tokens."""
        return {place for place, weight in self.net.inputs[transition] if self.tokens[place] < weight}

    def fire(self, transition: int, times: int = 1) -> None:
        """Fire the transition `times` at once; raise `NotEnabled`, and change nothing, if the marking does not cover the preset."""
        net, tokens = self.net, self.tokens
        only, taken, given = net.only_input[transition], net.inputs[transition], net.outputs[transition]
        # Checked before any token moves, so that a refused firing leaves the marking as it was.
        # `missing` counts places for a single firing only; several at once need the weights to be looked at.
        if times > 1 or (self.missing[transition] if only is None else not tokens[only]):
            name = net.place_name
            short = {name(place): weight * times - tokens[place] for place, weight in taken if tokens[place] < weight * times}
            if short:
                raise NotEnabled(net.transition_name(transition), short)
        if times > 1:
            taken, given = ([(place, weight * times) for place, weight in arcs] for arcs in (taken, given))
        self.move(taken, given)

    def move(self, taken: Sequence[tuple[int, int]], given: Sequence[tuple[int, int]]) -> None:
        """Fire a transition that is known to be enabled, and of which all arcs are given."""
        tokens, counted = self.tokens, self._counted
        # A place that is both input and output is first emptied and then filled: each change is small and keeps `missing` exact.
        for place, weight in taken:
            if counted[place]:
                self._add(place, -weight)
            else:
                tokens[place] -= weight
        for place, weight in given:
            if counted[place]:
                self._add(place, weight)
            else:
                tokens[place] += weight

    def _add(self, place: int, count: int) -> None:
        missing, before = self.missing, self.tokens[place]
        after = self.tokens[place] = before + count
        for transition, weight in self._joins[place]:
            # Only a change across the weight matters: the place begins, or ceases, to be covered for this consumer.
            if before < weight <= after:
                missing[transition] -= 1
            elif after < weight <= before:
                missing[transition] += 1

    def marking(self) -> Marking:
        """Return the current marking."""
        return Marking({self.net.place_name(place): count for place, count in enumerate(self.tokens) if count})
