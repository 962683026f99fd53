"""Counters: pairs of places between which tokens move one at a time, such as retries left and retries spent.

How many tokens there are decides only how often something happens. So the proof looks at three cases, all left, some left and all
spent, and takes a counter to be in any of them at any time. The moves are looked at for themselves: as long as tokens move in one
direction only, they come to an end. So the work does not grow with the tokens, nor with the combinations of counters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pnm.core.machine.verification.part import Count, Left, Step, Unsound


def without_counts(
    steps: Sequence[Step], initial: Mapping[str, int], budgets: frozenset[str]
) -> tuple[tuple[Step, ...], dict[str, int], frozenset[str]]:
    """Return steps and tokens in which one place stands for each counter, marked as long as there is one, and those places.

    Raises:
        Unsound: places that count do not count in pairs: a step moves more than one token, or between others, or asks for neither one
            token nor all.
    """
    pairs = dict[str, tuple[str, str]]()
    for step in steps:
        if budgets.isdisjoint(step.outputs):
            continue
        given, taken = ([place for place in arcs if place in budgets] for arcs in (step.outputs, step.inputs))
        if len(given) != 1 or len(taken) != 1 or given == taken or step.inputs[taken[0]] != 1 or step.outputs[given[0]] != 1:
            raise Unsound(f"{step.name} does not move one token from one counter to another")
        pair = (taken[0], given[0]) if initial.get(taken[0]) else (given[0], taken[0])
        if any(pairs.setdefault(place, pair) != pair for place in pair):
            raise Unsound(f"{step.name} mixes counters: {taken[0]} and {given[0]} do not count together")
    for left, spent in pairs.values():
        if initial.get(spent):
            raise Unsound(f"some of the counter {left} is spent from the beginning")

    def abstract(step: Step) -> Step:
        if budgets.isdisjoint(step.inputs):
            return step
        taken = [place for place in step.inputs if place in budgets]
        left, spent = pairs.get(taken[0], (taken[0], ""))
        total, gives = initial.get(left, 0), any(place in budgets for place in step.outputs)
        if len(taken) > 1 or not (gives or step.inputs[taken[0]] == total):
            raise Unsound(f"{step.name} takes {step.inputs[taken[0]]} of {', '.join(taken)}, which is neither one nor all")
        inputs, outputs = (
            {place: weight for place, weight in arcs.items() if place not in budgets} for arcs in (step.inputs, step.outputs)
        )
        possible = frozenset(Left) if total > 1 else frozenset({Left.ALL, Left.NONE})
        if gives:
            cases = possible - {Left.NONE if taken[0] == left else Left.ALL}
        else:
            cases = frozenset({Left.ALL if taken[0] == left else Left.NONE})
        count = Count(left, cases, possible, (taken[0] == spent) if gives else None)
        return step._replace(inputs={**inputs, left: 1}, outputs={**outputs, left: 1} if gives else outputs, counted=count)

    kept = {place: tokens for place, tokens in initial.items() if place not in budgets}
    counters = frozenset(left for left, _ in pairs.values()) | {place for place in budgets if place not in pairs}
    return tuple(map(abstract, steps)), {**kept, **{place: 1 for place in counters if initial.get(place)}}, counters


def in_each_case(steps: Sequence[Step]) -> Iterator[list[list[Step]]]:
    """Yield for each counter that the steps ask for, if there is one, which of the steps are enabled in each of its cases.

    Steps that ask for another counter are left out: they may be enabled or not.
    """
    counts = {step.counted.place: step.counted for step in steps if step.counted}
    if not counts:
        yield [[*steps]]
    for place, count in counts.items():
        own = [step for step in steps if not step.counted or step.counted.place == place]
        yield [[step for step in own if not step.counted or case in step.counted.cases] for case in count.possible]
