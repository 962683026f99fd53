"""`pnm replay --json`: a line for each record, with what has come of it, and no longer however long a run goes on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from planner_bridge.cli.journal import replay
from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.tasks.result import TASKS
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from tests.support.files import written
from tests.support.tasks.scenarios.random_scenarios import run_scenario

ROUNDS = """
actions:
  count: {{params: [value], simulated: {{result: {{Operation: ["+", ["?value", 1]]}}}}}}
  keep: {{type: kb_action}}
initial_knowledge: {{value: 0}}
plan:
  - while:
      condition: {{Comparison: [ne, [LocalQuery: value, {rounds}]]}}
      limit: 1000
      actions:
        - count:
        - keep: {{operation: {{LocalUpdate: [value, {{LocalQuery: result}}]}}}}
"""


def lines(journal: Path) -> list[dict[str, Any]]:
    told = CliRunner().invoke(replay, [str(journal), "--json"], catch_exceptions=False)
    assert told.exit_code == 0
    return [json.loads(line) for line in told.stdout.splitlines()]


def test_the_lines_of_a_run_do_not_grow_with_it(tmp_path: Path) -> None:
    longest = []
    for rounds in (10, 90):
        plan, journal = written(tmp_path / f"{rounds}.yaml", ROUNDS.format(rounds=rounds)), tmp_path / f"{rounds}.journal"
        assert carry_out(plan, journal=journal).goal_reached
        longest.append(max(len(json.dumps({**line, "record": ""})) for line in lines(journal)[6:]))
    assert longest[1] < 1.2 * longest[0]


@pytest.mark.parametrize("number", range(6))
def test_what_the_lines_say_of_places_and_calls_adds_up_to_what_is_so(number: int, tmp_path: Path) -> None:
    run_scenario(number, journal=tmp_path / "journal")
    markings: dict[str, dict[str, int]] = {}
    results: dict[str, dict[str, str]] = {}
    for line in lines(tmp_path / "journal"):
        if "fired" in line:
            run = line["record"]["run"]
            markings.setdefault(run, {}).update(line["marking"])
            results.setdefault(run, {}).update(line["results"])
    state = Replay()
    for _ in replay_steps(tmp_path / "journal", TASKS, state):
        pass
    assert markings
    for id, replayed in state.runs.items():
        marked = {place: tokens for place, tokens in markings.get(id.hex, {}).items() if tokens}
        assert all(replayed.run.marking[place] == tokens for place, tokens in marked.items())
        said = {str(result.call): result.outcome for result in replayed.run.results if result.kind.name != "WAITING"}
        assert said.items() <= results.get(id.hex, {}).items()
