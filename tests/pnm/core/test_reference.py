"""The run does what the definition of a Petri Net Machine says; a run that does not is found out; nothing is asked again needlessly."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest
from hypothesis import given, settings, strategies as st

from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld
from pnm.clock import run_async
from pnm.core.execution.call_requests import Calls
from pnm.core.execution.events import (
    Answered,
    Ask,
    Begin,
    Cancel,
    Event,
    InHands,
    KnowledgeChanged,
    Pause,
    Performed,
    Resume,
    Send,
    Tick,
    Wake,
)
from pnm.core.execution.questions import LIMITS
from pnm.core.execution.run import Run
from pnm.core.execution.run_state import Agenda, RunState
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import MISSING, Literal, Query
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Not
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule, Rules
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Choice, Flow, GroundAction, Loop, PlanGraph, Step
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.executor import Executor
from pnm.journal.journal import Journal, Perform
from tests.support.runs.commands import RUN, in_its_moment
from tests.support.runs.held_run import HeldRun, Unrest, hold_against_reference
from tests.support.yaml.programs import only_plan, programs


def _hold(numbers: range) -> None:
    for number in numbers:
        hold_against_reference(number)


def test_the_run_is_as_the_reference() -> None:
    _hold(range(50))


@settings(max_examples=15)
@given(programs(), st.integers(0, 2**32))
def test_any_program_runs_as_in_the_reference(text: str, seed: int) -> None:
    found, random = only_plan(text), Random(seed)
    machine = generate(found.graph, found.bindings, on_failure=found.on_failure)
    world = KnowledgeBase(found.facts, objects=found.objects, rules=found.rules)
    knowledge = Layered(world, KnowledgeBase(variables=found.variables))
    run = HeldRun(machine, knowledge, bindings=found.bindings, asks=random.random() < 0.7)
    for _ in Unrest(run, knowledge, random).drive():
        pass


def _asking() -> HeldRun:
    """A run of a call whose place a person has to name."""
    machine = generate(PlanGraph((ActionCall(0, GroundAction("asked", ("?y",), ("y",))),)))
    return HeldRun(machine, Layered(KnowledgeBase()), bindings=Bindings({"asked": Binding(ask={"y": "Which one?"})}), asks=True)


def test_what_a_call_needs_is_asked_for_only_where_it_would_begin() -> None:
    """People have something in hand: whether the call needs that is no matter of its other transitions."""
    run = _asking()
    run.handle(InHands(("arm",)), 0.0)
    assert any(isinstance(command, Ask) for command in run.handle(Begin(), 0.0))
    assert "asked(?y)#0 join" in [run.machine.net.transitions[number] for number in run.fired]


def test_the_moment_of_a_question_that_is_answered_wakes_nobody() -> None:
    run = _asking()
    run.handle(Pause(), 0.0)
    (asked,) = (command for command in run.handle(Begin(), 0.0) if isinstance(command, Ask))
    (person,) = (command for command in run.handle(Answered(asked.id, MISSING), 0.0) if isinstance(command, Ask))
    assert run.handle(Answered(person.id, "hall"), 1.0) == []
    assert run.handle(Tick(), LIMITS[asked.question.layer]) == [], "nothing is waited for but the end of the pause"


def test_the_moment_of_a_place_that_its_token_has_left_wakes_nobody() -> None:
    calls = (ActionCall(0, GroundAction("quick")), ActionCall(1, GroundAction("slow")))
    bindings = Bindings({"quick": Binding(timeout=30.0), "slow": Binding(timeout=90.0)})
    run = HeldRun(generate(PlanGraph(calls), bindings), Layered(KnowledgeBase()), bindings=bindings)
    quick, slow = (command.request.id for command in run.handle(Begin(), 0.0) if isinstance(command, Send))
    for event in (Accepted(quick), Accepted(slow), Ended(quick, Outcome(OutcomeKind.SUCCEEDED))):
        run.handle(event, 1.0)
    assert run.handle(Tick(), 20.0) == [Wake(91.0)], "the limit of the quick one would be over at 31"


BROKEN: dict[str, tuple[type, str, Callable[..., object] | property]] = {
    "what has changed is not looked at": (Agenda, "ask_about_knowledge", lambda *_, of_all=False: None),
    "places are asked in another order": (Agenda, "ask_undecided", lambda agenda: agenda.places.extend(reversed(agenda.undecided))),
    "a pause starts calls": (Run, "_is_put_off", lambda run, site, firing, place: False),
    "nothing is ever cancelled": (RunState, "cancels", property(lambda state: False)),
    "a request is numbered twice": (Calls, "_next", lambda calls, call: (1, calls.identity(f"{call}/1"))),
    "actions are not carried out": (Calls, "perform", lambda *_: Performed()),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_run_that_does_otherwise_is_found_out(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, instead = BROKEN[what]
    monkeypatch.setattr(owner, name, instead)
    with pytest.raises(AssertionError):
        _hold(range(200))


# --- a change of facts has those places asked again that read them ---


ROOMS = ("hall", "kitchen")
OPEN, WARM, DONE = (tuple((name, room) for room in ROOMS) for name in ("open", "warm", "done"))
RULES = Rules((DerivationRule("fit", (Variable("?r", ("room",)),), All((Holds(("open", "?r")), Not(Holds(("warm", "?r")))))),))
FLUENTS = (*OPEN, *WARM, *DONE)
PLAIN = st.one_of(  # all of them hold at first
    st.sampled_from(OPEN).map(Holds),
    st.sampled_from((*WARM, *DONE)).map(lambda fluent: Not(Holds(fluent))),
    st.sampled_from(ROOMS).map(lambda room: Holds(("fit", room))),
    st.sampled_from(ROOMS).map(lambda room: Compare(">=", ValueOf(("level", room)), Constant(2.0))),
    st.sampled_from(["open", "fit"]).map(lambda name: ForAll((Variable("?r", ("room",)),), Holds((name, "?r")))),
    st.sampled_from(["open", "fit"]).map(lambda name: Exists((Variable("?r", ("room",)),), Holds((name, "?r")))),
    st.just(Computed(Query(Literal.of("go")))),
)
CONDITIONS: st.SearchStrategy[Condition] = st.one_of(
    st.just(TRUE), PLAIN, st.lists(PLAIN, max_size=2).map(tuple).map(All), st.lists(PLAIN, min_size=2, max_size=2).map(tuple).map(Any)
)


@st.composite
def calls(draw: st.DrawFn, index: int) -> ActionCall:
    effects = tuple(Set(fluent, Constant(True)) for fluent in draw(st.lists(st.sampled_from(DONE), max_size=1)))
    action = GroundAction(
        f"a{index}",
        (draw(st.sampled_from(["hall", "hall", "hall", "?r"])),),
        ("r",),
        precondition=draw(CONDITIONS),
        invariant=draw(CONDITIONS),
        end_condition=draw(CONDITIONS),
        end_effects=effects,
    )
    return ActionCall(index, action)


@st.composite
def plans(draw: st.DrawFn) -> PlanGraph:
    made = [draw(calls(index)) for index in range(4)]
    steps: list[Step] = [*made[:2]]
    steps.append(Loop(4, draw(CONDITIONS), Flow((made[2],)), 2))
    steps.append(Choice(5, draw(CONDITIONS), Flow((made[3],)), Flow()))
    return PlanGraph(tuple(steps), rules=RULES)


CHANGES = st.one_of(
    st.tuples(st.sampled_from(FLUENTS), st.booleans()),
    st.tuples(st.sampled_from([("level", room) for room in ROOMS]), st.sampled_from([1.0, 3.0])),
    st.tuples(st.just("go"), st.booleans()),
)


class Scene:
    """A run, and the world that it is in."""

    def __init__(self, plan: PlanGraph, known: dict, sensed: dict[str, float], kind: type[Run] = Run) -> None:
        rules = replace(RULES)  # those of a world and of a plan are equal, and seldom one object
        self.world = KnowledgeBase(known, objects={"room": ROOMS}, sensed=sensed, rules=rules, variables={"r": "hall", "go": True})
        bindings = Bindings({f"a{index}": Binding(retries=1, resources=("arm",) if index == 0 else ()) for index in range(4)})
        self.run = kind(generate(plan, bindings), Layered(self.world), bindings=bindings, **({"id": RUN} if kind is Run else {}))

    def change(self, what: object, value: object) -> None:
        if isinstance(what, str):
            self.world.store({what: value})
        else:
            self.world.update({what: value})


@given(st.data())
def test_what_has_changed_has_all_places_asked_again_that_the_reference_would_ask(data: st.DataObject) -> None:
    known = {fluent: fluent in OPEN for fluent in FLUENTS} | {("level", room): 3.0 for room in ROOMS}
    sensed = {name: data.draw(st.sampled_from([0.0, 1.0])) for name in data.draw(st.sets(st.sampled_from(["open", "warm", "done"])))}
    scene, now = Scene(data.draw(plans()), known, sensed, HeldRun), 0.0
    scene.run.handle(Begin(), now)
    for _ in range(data.draw(st.integers(5, 25))):
        now += data.draw(st.sampled_from([0.0, 0.0, 0.5, 1.0]))
        event: Event = Tick()
        match data.draw(st.sampled_from(["changed", "changed", "changed", "tick", "accepted", "accepted", "ended", "pause"])):
            case "changed":
                scene.change(*data.draw(CHANGES))
                event = KnowledgeChanged()
            case "pause":
                event = data.draw(st.sampled_from([Pause(), Pause(at_once=True), Resume()]))
            case "accepted" | "ended" as kind if requests := scene.run.open_requests:
                request = data.draw(st.sampled_from(requests))
                ends = st.sampled_from([OutcomeKind.SUCCEEDED, OutcomeKind.SUCCEEDED, OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED])
                event = Accepted(request) if kind == "accepted" else Ended(request, Outcome(data.draw(ends)))
        scene.run.handle(event, now)


ROOM = (Variable("?r", ("room",)),)
BREAKS: list[tuple[Condition, object, object]] = [
    (Holds(OPEN[0]), OPEN[0], False),
    (Not(Holds(WARM[1])), WARM[1], True),
    (Any((Holds(OPEN[0]), Holds(WARM[0]))), OPEN[0], False),
    (Holds(("fit", "hall")), WARM[0], True),
    (Compare(">=", ValueOf(("level", "hall")), Constant(2.0)), ("level", "hall"), 1.0),
    (ForAll(ROOM, Holds(("open", "?r"))), OPEN[1], False),
    (Not(Exists(ROOM, Not(Holds(("fit", "?r"))))), OPEN[1], False),
    (Computed(Query(Literal.of("go"))), "go", False),
]


@pytest.mark.parametrize(("condition", "what", "value"), BREAKS)
def test_a_condition_over_all_is_looked_at_when_something_changes_that_it_reads(condition: Condition, what: object, value: object) -> None:
    calls = tuple(ActionCall(index, GroundAction(f"a{index}", invariant=invariant)) for index, invariant in ((0, TRUE), (1, condition)))
    known = {fluent: fluent in OPEN for fluent in FLUENTS} | {("level", room): 3.0 for room in ROOMS}
    scene = Scene(PlanGraph(calls, rules=RULES), known, {})
    scene.run.handle(Begin(), 0.0)
    for request in scene.run.open_requests:
        scene.run.handle(Accepted(request), 0.0)
    scene.change(DONE[0], True)
    asked: list[int] = []
    scene.run._decide = lambda place, *_: asked.append(place)  # type: ignore[method-assign]
    scene.run.handle(KnowledgeChanged(), 0.0)
    assert len(asked) == isinstance(condition, Computed), "nothing reads what has changed; of a computed value nobody knows"
    del scene.run._decide
    scene.change(what, value)
    assert any(isinstance(command, Cancel) for command in in_its_moment(scene.run, KnowledgeChanged(), 0.0))


def test_places_are_asked_by_the_rules_of_the_world_also_when_it_has_begun_anew() -> None:
    """A world that several plans share has the rules of all of them: what a plan reads follows from those."""
    (fit,) = RULES.rules
    calls = (ActionCall(0, GroundAction("a0", invariant=Holds(("fit", "hall")))),)
    known = {fluent: fluent in OPEN for fluent in FLUENTS}
    scene = Scene(PlanGraph(calls, rules=RULES), known, {})
    scene.run.handle(Begin(), 0.0)
    scene.run.handle(Accepted(*scene.run.open_requests), 0.0)
    broken = Rules((replace(fit, condition=All((fit.condition, Not(Holds(("broken", "?r")))))),))
    scene.world.begin_anew(scene.world.facts(), scene.world.objects_by_type(), broken)
    assert in_its_moment(scene.run, KnowledgeChanged(), 0.0) == []
    scene.change(("broken", "hall"), True)
    assert any(isinstance(command, Cancel) for command in in_its_moment(scene.run, KnowledgeChanged(), 0.0))


class Heard(Journal):
    """A journal of nothing but which events a run has handled."""

    def __init__(self) -> None:
        self.events: list[type] = []

    def handle(self, run: Run, event: Event, now: float, perform: Perform) -> None:
        self.events.append(type(event))
        super().handle(run, event, now, perform)


@pytest.mark.parametrize(
    ("precondition", "invariant", "heard_of"), [(TRUE, TRUE, 0), (Holds(("late",)), TRUE, 2), (TRUE, Holds(("powered",)), 0)]
)
def test_an_executor_hears_of_facts_only_while_something_waits_for_them(
    precondition: Condition, invariant: Condition, heard_of: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, hears_of = list[bool](), Run.hears_of
    monkeypatch.setattr(Run, "hears_of", lambda run, changes: bool(asked.append(True)) or hears_of(run, changes))
    effects = (Set(("late",), Constant(True)),)
    calls = (
        ActionCall(0, GroundAction("does", duration=5.0, invariant=invariant, end_effects=effects)),
        ActionCall(1, GroundAction("waits", precondition=precondition)),
    )
    heard, world = Heard(), KnowledgeBase({("powered",): True}, sensed={"late": 9.0})
    robots = SimulatedRobots(SimulatedWorld(world, frozenset()))
    run = Run(generate(PlanGraph(calls)), Layered(world), id=RUN)

    async def main() -> None:
        executor = asyncio.ensure_future(Executor(run, robots, journal=heard).execute())
        await asyncio.sleep(1.0)
        world.update({("other",): True})
        await asyncio.sleep(1.0)
        world.update({("late",): True})
        assert (await executor).goal

    run_async(main(), virtual=True)
    assert heard.events.count(KnowledgeChanged) == heard_of
    assert bool(asked) is ((precondition, invariant) != (TRUE, TRUE)), "what waits for no facts is not even asked"
