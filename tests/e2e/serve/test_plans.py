"""Plans as action servers: goals, results, feedback and cancelling over ROS 2, with action servers and clients in other processes."""

from __future__ import annotations

import pytest

from tests.support.e2e.plan_deployment import ABORTED, CANCELED, SUCCEEDED, PlanDeployment, Workers
from tests.support.e2e.plan_files import DOMAIN, PLANS, shared


@pytest.fixture(scope="module")
def workers(deployment_of_module: PlanDeployment) -> Workers:
    return deployment_of_module.workers("add_one", "broken", "dummy_server", "wait").ready()


@pytest.fixture(scope="module")
def knowing(deployment_of_module: PlanDeployment) -> Workers:
    return deployment_of_module.workers(script="asking_servers").ready()


@pytest.fixture(scope="module")
def served(deployment_of_module: PlanDeployment, workers: Workers, knowing: Workers) -> PlanDeployment:
    """A process that serves all of the plans, with the action servers that they need."""
    deployment_of_module.write(
        {
            "domain.yaml": DOMAIN,
            "plans.yaml": PLANS,
            "world.yaml": "mine: {domain: domain.yaml, recipes: [plans.yaml]}\nother: {domain: domain.yaml, recipes: [plans.yaml]}",
        }
    )
    deployment_of_module.serve("--name", "mine").ready()
    return deployment_of_module


# --- what fails ------------------------------------------------------------------------------


WRONG = {
    '{"tim": 3}': "waits has no parameter 'tim'; did you mean 'time'?",
    "[1": "parameters:1:3: ",
    "3": "expected a mapping such as {shop: bakery} as parameters, found '3'",
    "{time: !!python/object/apply:os.system [ls]}": "parameters:1:",
}


def test_parameters_that_are_wrong_abort_the_goal_with_the_reason(served, workers):
    before = len(workers.objects())
    for result, said in zip(served.client("waits", *WRONG).results(), WRONG.values(), strict=True):
        assert (result["status"], result["success"], result["reason"], result["results"]) == (ABORTED, False, "parameters", {})
        assert said in result["message"]
    assert len(workers.objects()) == before


def test_when_one_branch_fails_the_others_end_what_they_are_doing_and_begin_nothing(served, workers):
    result = served.client("forks").result()
    assert (result["status"], result["reason"]) == (ABORTED, "aborted")
    workers.happens("end", "wait", 0.25)
    workers.happens("end", "wait", 0.5)
    assert 78 not in workers.starts("wait")


# --- cancelling ------------------------------------------------------------------------------


def test_a_goal_that_is_cancelled_ends_when_the_action_server_has_confirmed_it(served, workers):
    client = served.client("waits", {"time": 3006}, cancel_on="wait")
    result = client.result()
    assert (result["status"], result["success"], result["reason"]) == (CANCELED, False, "cancelled")
    workers.happens("cancelled", "wait", 3006)
    assert client.hears("feedback", running=["wait(3006)"])["ended"] == 0


def test_cancelling_reaches_what_a_plan_runs_that_is_called_by_another(served, workers):
    client = served.client("calls", {"shop": "bakery"}, cancel_on="wait")
    result = client.result()
    assert (result["status"], result["reason"]) == (CANCELED, "cancelled")
    workers.happens("cancelled", "wait", 3003)
    client.hears("feedback", running=["called(bakery, 3003): wait(3003)"])


def test_an_action_that_somebody_else_cancels_is_no_failure(served, workers):
    client = served.client("goes_on")
    workers.happens("start", "wait", 3001)
    served.cancel_all("wait")
    result = client.result()
    assert (result["status"], result["results"]) == (SUCCEEDED, {"result": 42})


# --- what goes well --------------------------------------------------------------------------


def test_a_loop_counts_from_five_to_ten(served, workers):
    before = len(workers.starts("add_one"))
    result = served.client("count").result()
    assert (result["status"], result["results"]) == (SUCCEEDED, {"value": 10, "result": 10})
    assert workers.starts("add_one")[before:] == [5, 6, 7, 8, 9]
    assert workers.starts("dummy_server") == [5]


def test_goals_for_the_same_plan_run_side_by_side_with_their_own_knowledge(served, workers):
    before = len(workers.objects())
    results = served.client("waits", *({"time": time} for time in (1.5, 2.5))).results()
    assert [result["status"] for result in results] == [SUCCEEDED] * 2
    events = [(one["event"], one["value"]) for one in workers.objects()[before:]]
    assert sorted(events[:2]) == [("start", 1.5), ("start", 2.5)]
    assert sorted(events[2:]) == [("end", 1.5), ("end", 2.5)]


def test_what_an_action_server_stores_while_it_runs_is_used_by_later_steps_of_its_own_run(served, workers):
    results = served.client("knows", {"value": 0}, {"value": 1}).results()
    assert [result["status"] for result in results] == [SUCCEEDED] * 2
    assert [(result["results"]["spam"], result["results"]["time"]) for result in results] == [(0, 0), (1, 1)]
    assert {0, 1} <= set(workers.starts("wait"))
    assert {result["results"]["eggs"] for result in results} <= {100, 101}


def test_what_is_stored_for_all_is_found_by_other_runs_and_by_other_programs(served):
    assert served.client("knows", {"value": 2}).result()["status"] == SUCCEEDED
    assert served.client("asks_what_is_shared").result()["results"] == {"eggs": 102}
    assert shared(served.knowledge, "eggs") == 102


def test_a_condition_hears_of_what_an_action_server_stores_while_it_runs(served, workers, knowing):
    result = served.client("alarmed").result()
    assert (result["status"], result["reason"]) == (ABORTED, "invariant_false")
    workers.happens("cancelled", "wait", 3002)
    knowing.happens("cancelled", "alarm", 1)
