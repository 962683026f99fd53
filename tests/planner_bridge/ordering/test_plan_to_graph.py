"""The causal order of plans: as loose as the causes allow, and never looser."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import pytest

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.planning.solve import solve
from pnm.core.logic.conditions import All, Holds, Not
from pnm.core.logic.trajectory import Constraint
from tests.support.pddl.problems import matches, rooms
from tests.support.runs.plan_graphs import shown
from tests.support.runs.timing import functions_called
from tests.support.tasks.planned_runs import SimulatedSite, on_site, timed


def sequence(*steps: str) -> Plan:
    return Plan(tuple(PlanStep(step.split()[0], tuple(step.split()[1:]), float(index)) for index, step in enumerate(steps)))


@pytest.mark.parametrize(
    ("steps", "orderings"),
    [
        (["move r1 a b", "move r2 a d"], []),
        (["move r1 a b", "move r2 a b"], []),  # of a counter that only a metric reads nothing follows
        (["move r1 a b", "move r1 b c"], ["end of #0 < start of #1 ((at r1 b))"]),
        (["sweep r1 a", "move r1 a b"], ["end of #0 < start of #1 ((at r1 a))"]),  # a reader before the next writer
    ],
)
def test_an_ordering_names_the_fact_it_protects(steps: list[str], orderings: list[str]) -> None:
    assert shown(plan_graph(rooms(), sequence(*steps))) == orderings


LAMP = """
(define (domain lamp)
  (:requirements :strips :typing)
  (:types button)
  (:predicates (pressed ?b - button) (lit) (read) (dark))
  (:action press :parameters (?b - button) :effect (and (pressed ?b) (lit)))
  (:action read_on :parameters () :precondition (lit) :effect (read))
  (:action look :parameters () :precondition (or (lit) (read)) :effect (read))
  (:action switch_off :parameters () :precondition (read) :effect (and (not (lit)) (dark))))
"""


@pytest.mark.parametrize(
    ("steps", "orderings"),
    [
        (["press a", "press b"], []),
        (["press a", "read_on", "press b"], ["end of #0 < start of #1 ((lit))"]),
        (["press a", "press b", "read_on"], ["end of #1 < start of #2 ((lit))"]),
        (  # what reads joint conditions sees every writer before it
            ["press a", "press b", "look"],
            ["end of #0 < start of #2 ((lit))", "end of #1 < start of #2 ((lit))"],
        ),
        (  # another value comes after all of them, and they before or after it
            ["press a", "read_on", "press b", "switch_off", "press a", "press b"],
            [
                "end of #0 < start of #1 ((lit))",
                "end of #0 < start of #3 ((lit))",
                "end of #1 < start of #3 ((read), (lit))",
                "end of #2 < start of #3 ((lit))",
                "end of #3 < start of #4 ((lit))",
                "end of #3 < start of #5 ((lit))",
            ],
        ),
    ],
)
def test_writers_of_the_same_value_do_not_wait_for_each_other(steps: list[str], orderings: list[str]) -> None:
    text = "(define (problem p) (:domain lamp) (:objects a b - button) (:init) (:goal (lit)))"
    assert shown(plan_graph(parse_problem(text, parse_domain(LAMP)), sequence(*steps))) == orderings


def never_both(room: str) -> Constraint:
    return Constraint("always", (Not(All((Holds(("at", "r1", room)), Holds(("at", "r2", room))))),))


def test_what_a_constraint_speaks_of_changes_in_the_order_of_the_plan() -> None:
    two = sequence("move r1 a b", "move r2 a b")
    constrained = replace(rooms(), constraints=(never_both("b"),))
    assert shown(plan_graph(constrained, two)) == ["end of #0 < start of #1 ((always (not (and (at r1 b) (at r2 b)))))"]
    elsewhere = replace(rooms(), domain=replace(rooms().domain, constraints=(never_both("d"),)))
    assert shown(plan_graph(elsewhere, two)) == []


def test_a_network_of_tasks_keeps_the_order_of_the_plan() -> None:
    network = replace(rooms(), network="(:htn)")
    assert shown(plan_graph(network, sequence("move r1 a b", "move r2 a d", "sweep r1 b"))) == [
        "end of #0 < start of #1 ((order of tasks))",
        "end of #0 < start of #2 ((at r1 b))",
        "end of #1 < start of #2 ((order of tasks))",
    ]


def test_what_a_constraint_with_times_speaks_of_does_not_change_before_its_time() -> None:
    plan = Plan((PlanStep("strike", ("m0",), 6.0, 8.0), PlanStep("strike", ("m1",), 7.0, 8.0)), temporal=True)
    dark = Constraint("hold-during", (Not(Holds(("light", "m0"))),), (0.0, 5.0))
    soon = Constraint("within", (Holds(("light", "m1")),), (9.0,))
    graph = plan_graph(replace(matches(2), constraints=(dark, soon)), plan)
    assert [call.release for call in graph.calls] == [6.0, 0.0]


TWO_MATCHES = (
    PlanStep("strike", ("m0",), 0.0, 8.0),
    PlanStep("mend", ("f0", "m0"), 0.0, 5.0),
    PlanStep("strike", ("m1",), 3.0, 8.0),
    PlanStep("mend", ("f1", "m1"), 5.0, 5.0),
)


def test_an_enveloping_call_keeps_the_plans_distance_from_what_its_insides_wait_for() -> None:
    graph = plan_graph(matches(2), Plan(TWO_MATCHES, temporal=True))
    assert "start of #1 + 3.08 s < start of #2 ((light m1))" in shown(graph)  # 1 % of its 8 s later than the plan


def lasting(actions: str, init: str = "", goal: str = "(done)") -> Problem:
    """A problem about p, q, w, open, done, and more; each action is a name, its duration, its condition and its effect."""
    schemas = (line.split(";") for line in filter(str.strip, actions.splitlines()))
    text = " ".join(
        f"(:durative-action {name} :parameters () :duration (= ?duration {seconds}) :condition {condition} :effect {effect})"
        for name, seconds, condition, effect in schemas
    )
    domain = parse_domain(f"(define (domain d) (:requirements :adl :durative-actions :timed-initial-literals){FACTS} {text})")
    return parse_problem(f"(define (problem p) (:domain d) (:init {init}) (:goal {goal}))", domain)


FACTS = " (:predicates (p) (q) (w) (on) (open) (first) (seen) (done) (gone))"


def test_calls_that_fill_another_to_the_last_moment_are_carried_out() -> None:
    problem = lasting("""
        cover; 219.04; (); (and (at start (on)) (at end (not (on))))
        one; 139; (over all (on)); (at end (first))
        look; 2; (at start (first)); (at end (seen))
        two; 80.04; (and (over all (first)) (over all (on)) (at end (seen))); (at end (done))""")
    result = achieve(None, problem)
    assert result.goal_reached
    assert [call.outcome for call in result.calls] == ["succeeded"] * 4
    assert result.replans == 0


def test_an_enveloping_call_waits_for_what_the_plan_had_happen_before_its_start() -> None:
    late = (*TWO_MATCHES[:2], replace(TWO_MATCHES[2], start=6.0), replace(TWO_MATCHES[3], start=6.0))
    graph = plan_graph(matches(2), Plan(late, temporal=True))
    assert "end of #1 < start of #2 ((light m1))" in shown(graph)


def steps_taken(fuses: int) -> int:
    """How many functions are called to order so many matches, one after the other, each with a fuse."""
    pairs = ((PlanStep("strike", (f"m{n}",), 9.0 * n, 8.0), PlanStep("mend", (f"f{n}", f"m{n}"), 9.0 * n, 5.0)) for n in range(fuses))
    problem, plan = matches(fuses), Plan(tuple(step for pair in pairs for step in pair), temporal=True)
    with functions_called() as called:
        plan_graph(problem, plan)
    return called()


def test_what_is_far_away_in_the_plan_is_not_looked_at() -> None:
    assert steps_taken(160) < 4.5 * steps_taken(40)


@pytest.mark.parametrize("fuses", [1, 2, 4])
def test_calls_inside_others_end_when_the_plan_says(fuses: int) -> None:
    problem = matches(fuses)
    found = solve(problem).plan
    assert found
    result = achieve(None, problem)
    assert result.goal_reached
    assert result.replans == 0
    assert max(call.ended or 0.0 for call in result.calls) - result.began == pytest.approx(found.makespan, rel=0.05)


def test_an_enveloping_call_is_not_earlier_than_what_its_insides_are_released_for() -> None:
    actions = """
        light; 8; (); (and (at start (on)) (at end (not (on))))
        pass; 2; (and (at start (open)) (over all (on))); (at end (done))"""
    problem = lasting(actions, "(at 70 (open))")
    graph = plan_graph(problem, timed("65 8 light", "70 2 pass"))
    assert [call.release for call in graph.calls] == [65.08, 70.0]
    assert achieve(None, problem).replans == 0


def test_an_end_does_not_come_before_a_start_that_must_precede_it() -> None:
    actions = """
        a; 8; (); (at end (not (p)))
        make-w; 5; (); (at end (w))
        b; 1; (and (at start (p)) (at start (w))); (at end (done))"""
    graph = plan_graph(lasting(actions, "(p)", "(and (done) (w))"), timed("0 8 a", "0 5 make-w", "5.001 1 b"))
    assert "start of #1 + 0.08 s < start of #0 ((p))" in shown(graph)
    assert "start of #2 < end of #0 ((p))" in shown(graph)


TIMED = """
    work; 5; (at end (open)); (at end (done))
    begin; 5; (at start (p)); (at end (done))
    hold; 10; (over all (p)); (at end (done))
    hold-either; 10; (over all (or (p) (open))); (at end (done))
    remove; 1; (); (and (at start (not (p))) (at end (gone)))"""


def test_an_end_that_needs_a_timed_fact_is_not_reached_too_early() -> None:
    problem = lasting(TIMED, "(at 70 (open))")
    released = [plan_graph(problem, timed(f"{start} 5 work")).calls[0].release for start in (70.0, 65.001)]
    assert released == [65.05, 65.001], "a little after it could, but no later than planned"


@pytest.mark.parametrize(
    ("init", "step", "latest_start", "deadline"),
    [
        ("(p) (at 12 (not (p)))", "0 5 begin", 12.0, inf),  # a start that the change would make impossible
        ("(p) (at 12 (not (p)))", "0 10 hold", inf, 12.0),  # what it would break must end before
        ("(p) (at 12 (p))", "0 10 hold", inf, inf),
        ("(p) (open) (at 5 (not (p)))", "0 10 hold-either", inf, inf),  # in the middle, it leaves the condition true
    ],
)
def test_a_timed_change_is_a_limit_for_what_it_makes_false(init: str, step: str, latest_start: float, deadline: float) -> None:
    (call,) = plan_graph(lasting(TIMED, init), timed(step)).calls
    assert (call.latest_start, call.deadline) == (latest_start, deadline)


# --- start effects that last ---


LAMPS = parse_domain("""
(define (domain lamps) (:requirements :durative-actions :negative-preconditions :timed-initial-literals)
  (:predicates (light) (mended) (tested) (seen))
  (:durative-action mend :parameters () :duration (= ?duration 5) :condition (at start (light))
    :effect (and (at start (not (light))) (at end (mended))))
  (:durative-action test :parameters () :duration (= ?duration 1) :condition (at start (not (light)))
    :effect (and (at end (light)) (at end (tested))))
  (:durative-action inspect :parameters () :duration (= ?duration 1) :condition (at start (mended))
    :effect (and (at end (light)) (at end (seen)))))
""")


def lamps(goal: str, timed_facts: str = "") -> Problem:
    return parse_problem(f"(define (problem p) (:domain lamps) (:init (light) {timed_facts}) (:goal (and {goal})))", LAMPS)


@pytest.mark.parametrize(
    ("plan", "timed_facts", "lasts"),
    [
        (("0 5 mend",), "", True),
        (("0 5 mend", "1 1 test"), "", False),
        (("0 5 mend", "6 1 test"), "", False),  # which may as well come at once
        (("0 5 mend", "6 1 inspect"), "", True),  # which waits for the end
        (("0 5 mend",), "(at 3 (light))", False),
        (("0 5 mend",), "(at 9 (light))", False),  # nothing says that the call has ended by then
    ],
)
def test_a_start_effect_is_expected_at_the_end_unless_something_may_overwrite_it(
    plan: tuple[str, ...], timed_facts: str, lasts: bool
) -> None:
    mend = plan_graph(lamps("(mended)", timed_facts), timed(*plan)).calls[0]
    assert mend.lasting == ({("light",)} if lasts else frozenset())


@on_site(lamps("(mended) (tested) (light)"))
async def test_what_comes_earlier_than_planned_is_no_failure_of_the_call_that_it_overwrites(site: SimulatedSite) -> None:
    result = await site.carry_out("0 5 mend", "6 1 test")
    assert result.goal, result.reason
    assert not result.failures
