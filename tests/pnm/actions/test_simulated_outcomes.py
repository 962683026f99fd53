"""Simulated robots whose actions have several outcomes: which one comes about, what it changes, and how the robot tells it."""

import re
from asyncio import get_running_loop
from collections import Counter
from dataclasses import replace
from uuid import uuid4

import pytest

from planner_bridge.model.grounding import ground_action
from planner_bridge.model.world import robots_of
from planner_bridge.pddl import parse_domain, parse_problem
from pnm.actions.faults import NO_FAULTS, Fault, Faults, read_faults
from pnm.actions.simulated_robots import result_of
from pnm.clock import run_async
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Request
from pnm.core.message_fields import Comparison, parse_field
from pnm.errors import InputError
from tests.support.files import written

PROBLEM = parse_problem(
    "(define (problem p) (:domain d) (:init) (:goal (held)))",
    parse_domain(
        """(define (domain d) (:requirements :strips :probabilistic-effects :non-deterministic)
        (:predicates (tried) (held) (dropped) (lost))
        (:action pick :effect (and (tried) (oneof (held) (dropped) (held) (and))))
        (:action catch :effect (probabilistic 0.75 (held) 0.15 (lost)))
        (:action wait :effect (tried)))"""
    ),
)

HELD, DROPPED = (Comparison(parse_field("code"), "eq", code) for code in (5, 7))
TELLS = Bindings({"pick": Binding(success=HELD, outcomes={"2": DROPPED})})


def performed(*names: str, faults: Faults = NO_FAULTS, bindings: Bindings = Bindings()) -> list[tuple[Outcome, frozenset[str]]]:
    """Return how actions end that are performed one after the other in a world in which nothing is so, and the facts after each."""

    async def perform() -> list[tuple[Outcome, frozenset[str]]]:
        robots, found = robots_of(PROBLEM, bindings, faults), []
        for name in names:
            ended = get_running_loop().create_future()
            robots.world.change(dict.fromkeys(robots.world.truth.facts(), False))
            request = Request(uuid4(), ground_action(PROBLEM.domain.actions[name], ()), {})
            robots.send(request, lambda report, ended=ended: isinstance(report, Ended) and ended.set_result(report.outcome))
            outcome = await ended
            found.append((outcome, frozenset(fluent[0] for fluent, value in robots.world.truth.facts().items() if value is True)))
        return found

    return run_async(perform(), virtual=True)


def test_outcomes_are_drawn_by_their_chances_and_change_the_world():
    found = performed(*["pick"] * 2000)
    assert all("tried" in facts and outcome.kind is OutcomeKind.SUCCEEDED for outcome, facts in found)
    names = {"1": {"held"}, "2": {"dropped"}, "4": set()}
    assert all(facts - {"tried"} == names[outcome.result["outcome"]] for outcome, facts in found)
    counts = Counter(outcome.result["outcome"] for outcome, _ in found)
    assert (counts["1"] / 2000, counts["2"] / 2000) == (pytest.approx(0.5, abs=0.05), pytest.approx(0.25, abs=0.05))


def test_chances_are_those_that_are_declared_and_what_is_left_changes_nothing():
    counts = Counter(facts for _, facts in performed(*["catch"] * 2000))
    shares = {frozenset({"held"}): 0.75, frozenset({"lost"}): 0.15, frozenset(): 0.1}
    assert {facts: count / 2000 for facts, count in counts.items()} == {
        facts: pytest.approx(share, abs=0.05) for facts, share in shares.items()
    }


def test_the_seed_of_faults_decides():
    runs = [[outcome.result for outcome, _ in performed(*["pick"] * 20, faults=Faults(seed=seed))] for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


def test_a_faults_file_says_which_outcome_it_is(tmp_path):
    faults = read_faults(
        written(tmp_path / "faults.yaml", "faults: [{action: pick, outcome: '2', after: 1, times: 2}]"), PROBLEM.vocabulary
    )
    found = performed(*["pick"] * 30, faults=faults)
    assert [outcome.result["outcome"] for outcome, _ in found][1:3] == ["2", "2"]
    assert len({outcome.result["outcome"] for outcome, _ in found}) == 3


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("action: pick", ":1:34: there is no outcome 'sliped' in the domain; did you mean 'slipped'?"),
        ("call: pick()", ":1:34: there is no outcome 'sliped' in the domain; did you mean 'slipped'?"),
        ("action: wait", ":1:34: wait can turn out in one way only, so there is no outcome 'sliped'"),
    ],
)
def test_a_faults_file_names_outcomes_that_there_are(tmp_path, call, message):
    file = written(tmp_path / "faults.yaml", f"faults: [{{{call}, outcome: sliped}}]")
    known = replace(PROBLEM.vocabulary, outcomes={"pick": ("held", "slipped")})
    with pytest.raises(InputError, match=re.escape(f"{file}{message}")):
        read_faults(file, known)


@pytest.mark.parametrize("action", ["pick", "wait"])
def test_an_outcome_that_an_action_does_not_have_fails_by_name(action):
    ((outcome, facts),) = performed(action, faults=Faults((Fault(action, outcome="9"),)))
    assert (outcome.kind, outcome.message, facts) == (OutcomeKind.ABORTED, f"{action}() has no outcome '9'", frozenset())


def test_an_action_without_several_outcomes_tells_none():
    ((outcome, _),) = performed("wait")
    assert outcome.result == {}


@pytest.mark.parametrize(("name", "told", "code"), [("1", "", 5), ("2", "2", 7)])
def test_an_outcome_is_told_in_the_result_as_its_binding_reads_it(name, told, code):
    ((outcome, _),) = performed("pick", faults=Faults((Fault("pick", outcome=name),)), bindings=TELLS)
    assert (outcome.declared, result_of(TELLS.of("pick"), outcome)) == (told, {"code": code})
    assert performed("pick", faults=Faults((Fault("pick", outcome="9"),)), bindings=TELLS)[0][0].declared == ""
