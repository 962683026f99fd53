"""A plan by hand that is started from another terminal, with parameters, asks a person, and is answered from a third one."""

from __future__ import annotations

import pytest

from tests.support.e2e.command_line import pnm, result
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.processes import Program

WORLD = """\
round:
  domain: domain.yaml
  params: [rounds]
  results: [go_on, rounds]
  initial_knowledge: {go_on: ""}
  plan:
    - note: {operation: {LocalUpdate: [go_on, {PersonQuery: [go_on, {text: "The pump is hot. Go on?", answers: ["yes", "no"]}]}]}}
"""
ASKS = "asks: The pump is hot. Go on? (yes or no)"


@pytest.fixture(scope="module")
def served(deployment_of_module: PlanDeployment) -> PlanDeployment:
    domain, world = "actions: {note: {type: kb_action}}", "mine: {domain: domain.yaml, recipes: [plans.yaml]}"
    deployment_of_module.write({"domain.yaml": domain, "plans.yaml": WORLD, "world.yaml": world})
    return deployment_of_module


def test_a_plan_is_started_and_its_question_is_seen_and_answered(served: PlanDeployment, monkeypatch: pytest.MonkeyPatch) -> None:
    node = served.serve().ready()
    for name, value in served.environment.items():
        monkeypatch.setenv(name, value)
    wrong = pnm("goal", "round", "--set", "round=2")
    assert (wrong.returncode, "round has no parameter 'round'; did you mean 'rounds'?" in wrong.output) == (2, True), wrong.output
    nobody = pnm("answer", "yes")
    assert (nobody.returncode, nobody.stderr) == (2, "no task is going on\n")
    client = served.pnm(Program, "goal", "round", "--set", "rounds=2")
    for program in (client, node):
        program.until(lambda out=program.out: any(ASKS in line for line in out))
    (task,) = (task for task in result(pnm("status", "--json"))["tasks"] if task["state"] == "running")
    assert task["reason"] == ASKS
    for words, said in (
        (["maybe"], "expected yes or no, found 'maybe'"),
        (["--name", "other", "yes"], "expected the name of one question: go_on (The pump is hot. Go on? (yes or no))"),
        (["zz", "yes"], "no task has an id that begins with 'zz'"),
    ):
        refused = pnm("answer", *words)
        assert (refused.returncode > 0, said in refused.stderr) == (True, True), refused.output
    assert pnm("answer", task["id"][:4], "yes").stdout == f"{task['id'][:8]}: answered\n"
    assert client.ended() == 0
    assert client.out[-2:] == ["goal     holds", "results  go_on: yes, rounds: 2"]
    assert "results" not in pnm("answer", "yes").output  # it is over
    named = pnm("goal", "round")  # without a value for its parameter
    assert (named.returncode, "rounds" in named.output) == (2, True), named.output
