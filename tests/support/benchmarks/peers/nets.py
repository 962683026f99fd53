"""Firing of nets by SNAKES, which is told where the tokens have gone, and by pm4py, which looks for what is enabled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.support.benchmarks.peers.worker import each

WIDTH = 8
ENOUGH = 200
"""Firings of pm4py in one round: each looks at the whole net."""

Arcs = list[tuple[list[int], list[int]]]
"""Of every transition the places before and behind it; a run begins with a token in place 0."""


def chain(length: int) -> Arcs:
    return [([index], [index + 1]) for index in range(length)]


def fork_join(length: int) -> Arcs:
    """Forks into branches that join again, until there are so many transitions."""
    arcs: Arcs = []
    last = 0
    for stage in range(max(1, length // (WIDTH + 2))):
        first = 1 + stage * (2 * WIDTH + 1)
        before, after = [*range(first, first + WIDTH)], [*range(first + WIDTH, first + 2 * WIDTH)]
        arcs.append(([last], before))
        arcs += (([one], [other]) for one, other in zip(before, after, strict=True))
        last = first + 2 * WIDTH
        arcs.append((after, [last]))
    return arcs


def places_of(arcs: Arcs) -> range:
    return range(1 + max(place for before, after in arcs for place in (*before, *after)))


def snakes(make: Callable[[int], Arcs], size: int) -> float:
    """Firing by SNAKES."""
    from snakes.nets import PetriNet, Place, Transition, Value

    arcs, net = make(size), PetriNet("net")
    for place in places_of(arcs):
        net.add_place(Place(f"p{place}", [1] if place == 0 else []))
    consumers: dict[int, list[int]] = {}
    for number, (before, after) in enumerate(arcs):
        net.add_transition(Transition(f"t{number}"))
        for place in before:
            net.add_input(f"p{place}", f"t{number}", Value(1))
            consumers.setdefault(place, []).append(number)
        for place in after:
            net.add_output(f"p{place}", f"t{number}", Value(1))
    transitions = [net.transition(f"t{number}") for number in range(len(arcs))]
    fired = 0

    def run() -> None:
        nonlocal fired
        agenda = [0]
        while agenda:
            for number in consumers.get(agenda.pop(), ()):
                if modes := transitions[number].modes():
                    transitions[number].fire(modes[0])
                    fired += 1
                    agenda.extend(arcs[number][1])

    took = each(run, len(arcs))
    assert fired == len(arcs)
    return took


def pm4py(make: Callable[[int], Arcs], size: int) -> float:
    """Firing by pm4py."""
    from pm4py.objects.petri_net import semantics
    from pm4py.objects.petri_net.obj import Marking, PetriNet
    from pm4py.objects.petri_net.utils.petri_utils import add_arc_from_to

    arcs, net = make(size), PetriNet("net")
    places = [PetriNet.Place(f"p{place}") for place in places_of(arcs)]
    net.places.update(places)
    for number, (before, after) in enumerate(arcs):
        transition = PetriNet.Transition(f"t{number}", f"t{number}")
        net.transitions.add(transition)
        for place in before:
            add_arc_from_to(places[place], transition, net)
        for place in after:
            add_arc_from_to(transition, places[place], net)
    firings = min(ENOUGH, len(arcs))

    def run() -> None:
        marking: Any = Marking({places[0]: 1})
        for _ in range(firings):
            marking = semantics.execute(next(iter(semantics.enabled_transitions(net, marking))), net, marking)

    return each(run, firings)
