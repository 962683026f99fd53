"""The firing rule as the definition reads. Pure; the oracle for `pnm.core.net.firing_engine`."""

from __future__ import annotations

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
