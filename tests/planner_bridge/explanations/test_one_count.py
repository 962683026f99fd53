"""One count and one word everywhere: `pnm run`, in words and as JSON, `pnm history` and the page say the same of a task."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planner_bridge.view.follow import Reader
from tests.support.e2e.command_line import pnm, result
from tests.support.files import ROOT, written

DOMAIN, PROBLEM = (str(ROOT / folder / "delivery" / file) for folder, file in (("domains", "domain.pddl"), ("problems", "p01.pddl")))
COUNTED = ("plans", "replans", "requests")


@pytest.mark.parametrize(
    "faults",
    [
        "faults: []",
        (ROOT / "problems" / "delivery" / "faults.yaml").read_text(),
        "faults: [{action: move, do: abort, times: 1}]",
        "faults: [{action: load, do: abort}]",
        "changes: [{at: 4.0, set: ['(not (at parcel1 store))', '(at parcel1 hall)']}]",  # a report sets a replan off
    ],
)
def test_a_task_is_counted_alike_wherever_it_is_looked_at(faults: str, tmp_path: Path) -> None:
    journal = str(tmp_path / "run.journal")
    run = ["run", DOMAIN, PROBLEM, "--improve", "0", "--faults", str(written(tmp_path / "faults.yaml", faults))]
    told = pnm(*run, "--json", "--journal", journal)
    as_json, shown = result(told), pnm(*run).stdout
    (listed,) = map(json.loads, pnm("history", "--json", "-v", journal).stdout.splitlines())
    (on_page,) = Reader(Path(journal)).newest().tasks.values()

    counts = {name: as_json[name] for name in COUNTED} | {"failures": len(as_json["failures"])}
    assert listed["counts"] == counts
    assert on_page["counts"] == ", ".join(f"{number} {name[: None if number != 1 else -1]}" for name, number in counts.items())
    assert on_page["counts"] in shown
    assert on_page["counts"] in pnm("history", "-v", journal).stdout
    assert counts["replans"] == len(listed["replanned"])
    assert [one["why"] for one in listed["replanned"]] == [
        run["replan"]["why"] for run in Reader(Path(journal)).newest().runs.values() if run["replan"]
    ]
    assert all(one["why"] in " ".join(shown.split()) for one in listed["replanned"])
    assert {as_json["code"], listed["code"], on_page["code"]} == {as_json["code"]}
    assert {as_json["reason"], listed["reason"], on_page["reason"]} == {as_json["reason"]}


NESTED = """
outer: {domain: domain.yaml, plan: [inner: , open: ]}
inner: {domain: domain.yaml, plan: [knock: , wait: , knock: ]}
"""


@pytest.mark.parametrize(("faults", "requests"), [("faults: []", 4), ("faults: [{action: wait, do: abort}]", 2)])
def test_requests_of_plans_that_a_plan_calls_count_and_such_a_call_does_not(faults: str, requests: int, tmp_path: Path) -> None:
    journal, file = str(tmp_path / "run.journal"), str(written(tmp_path / "plans.yaml", NESTED))
    written(tmp_path / "domain.yaml", "actions: {open: , knock: , wait: }")
    run = ["run", "--plan", file, "--name", "outer", "--faults", str(written(tmp_path / "faults.yaml", faults))]
    as_json, shown = result(pnm(*run, "--json", "--journal", journal)), pnm(*run).stdout
    (listed,) = map(json.loads, pnm("history", "--json", "-v", journal).stdout.splitlines())
    (on_page,) = Reader(Path(journal)).newest().tasks.values()
    assert as_json["requests"] == listed["counts"]["requests"] == requests
    assert on_page["counts"].startswith(f"{requests} requests, ")
    assert on_page["counts"] in shown
