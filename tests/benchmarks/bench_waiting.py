"""What runs cost that wait: for facts to change, and for resources. Not a test: `python tests/benchmarks/bench_waiting.py`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.support.benchmarks.waiting import constrained, heard, over_all, taking_turns


def changes() -> None:
    """A fact changes: one that nothing mentions, and one that one of many conditions over all, or constraints, does."""
    for count in (100, 10_000):
        for what, make in (("conditions over all", over_all), ("constraints", constrained)):
            world, look = make(count)
            of_none, of_one = (heard(world, look, fluent) for fluent in (("other",), ("fit", "r5")))
            said = f"{of_none:.1f} us if none mentions it (at most 5), {of_one:.1f} us if one does (at most 50)"
            print(f"a change among {count} {what}: {said}")


def one_resource() -> None:
<<<<<<< HEAD
    """Runs that all want the same resource; each hears of it whenever it may be free."""
    bindings = Bindings({"lift": Binding(resources=("lift",))})
    machine = generate(PlanGraph((ActionCall(0, GroundAction("lift")),)), bindings)
    costs = {}
    for count in (25, 200, 1_000):
        pool, world = Resources(), KnowledgeBase()
        runs = [
            Run(machine, Layered(world), id=UUID(int=number << 96), bindings=bindings, resources=pool) for number in range(1, count + 1)
        ]
        told: dict[Run, None] = {}
        for run in runs:
            pool.listen(lambda run=run, told=told: told.setdefault(run), run.task)  # type: ignore[misc]
        costs[count] = seconds(lambda runs=runs, told=told: in_turn(runs, told), 1) / count * 1e6  # type: ignore[misc]
    print(f"runs that want one resource: {', '.join(f'{count}: {cost:.0f} us' for count, cost in costs.items())} a call")


def in_turn(runs: list[Run], told: dict[Run, None]) -> None:
    """Have every run carry out its call."""
    sent = [(run, command) for run in runs for command in run.handle(Begin(), 0.0) if isinstance(command, Send)]
    while sent:
        run, command = sent.pop()
        run.handle(Accepted(command.request.id), 0.0)
        run.handle(Ended(command.request.id, Outcome(OutcomeKind.SUCCEEDED)), 0.0)
        run.retire()
        heard = [*told]
        told.clear()
        sent += [(one, new) for one in heard for new in one.handle(ResourcesChanged(), 0.0) if isinstance(new, Send)]
    assert all(run.over for run in runs)
=======
    """Runs that all want the same resource."""
    costs = ", ".join(f"{count}: {taking_turns(count):.0f} us" for count in (25, 200, 1_000))
    print(f"runs that want one resource: {costs} a call")
>>>>>>> bench


if __name__ == "__main__":
    changes()
    one_resource()
