"""Replays of journals: they do what was done, for whatever tasks and whatever goes wrong, and `pnm replay --json` tells all of it."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.tasks.result import TASKS
from pnm.errors import PnmError
from pnm.journal.codec import Undecodable
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps, replayed
from pnm.journal.store import JournalError, KeptJournal
from pnm.tasks import Code
from tests.support.e2e.command_line import pnm
from tests.support.files import written
from tests.support.tasks.scenarios.forged_journal import forged
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


@pytest.fixture(scope="module", params=range(3))
def scenario(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Counter[Code]]:
    """The journal of a random scenario, and how its tasks have ended."""
    journal = tmp_path_factory.mktemp("scenario") / "journal"
    return journal, run_scenario(request.param, journal=journal)


def lines(journal: Path) -> list[dict[str, Any]]:
    told = pnm("replay", str(journal), "--json")
    assert told.returncode == 0
    return [json.loads(line) for line in told.stdout.splitlines()]


def test_a_replay_does_what_tasks_have_done(scenario: tuple[Path, Counter[Code]]) -> None:
    journal, codes = scenario
    replay = replayed(journal, TASKS)
    assert all(entry.is_over or not entry.run.begun for entry in replay.runs.values())
    ended = [task.ending.code for task in replay.tasks.values() if task.ending]
    assert len(ended) == len(replay.tasks)
    assert not codes or sorted(ended) == sorted(codes.elements()) or len(ended) < codes.total()  # what was refused was never accepted


def test_what_the_lines_say_of_places_and_calls_adds_up_to_what_is_so(scenario: tuple[Path, Counter[Code]]) -> None:
    journal, _ = scenario
    markings: dict[str, dict[str, int]] = {}
    results: dict[str, dict[str, str]] = {}
    for line in lines(journal):
        if "fired" in line:
            run = line["record"]["run"]
            markings.setdefault(run, {}).update(line["marking"])
            results.setdefault(run, {}).update(line["results"])
    state = Replay()
    for _ in replay_steps(journal, TASKS, state):
        pass
    assert markings
    for id, told in state.runs.items():
        marked = {place: tokens for place, tokens in markings.get(id.hex, {}).items() if tokens}
        assert all(told.run.marking[place] == tokens for place, tokens in marked.items())
        said = {str(result.call): result.outcome for result in told.run.results if result.kind.name != "WAITING"}
        assert said.items() <= results.get(id.hex, {}).items()


def test_the_lines_of_a_run_do_not_grow_with_it(tmp_path: Path) -> None:
    longest = []
    for rounds in (10, 90):
        plan, journal = written(tmp_path / f"{rounds}.yaml", ROUNDS.format(rounds=rounds)), tmp_path / f"{rounds}.journal"
        assert carry_out(plan, journal=journal).goal_reached
        longest.append(max(len(json.dumps({**line, "record": ""})) for line in lines(journal)[6:]))
    assert longest[1] < 1.2 * longest[0]


@pytest.mark.parametrize(
    ("text", "error", "reason"),
    [
        ('{"@": "Stranger"}', Undecodable, "cannot be read behind record {}: there is no Stranger in this version"),
        ("[", Undecodable, r"cannot be read behind record {}: not a value of this version: \["),
        ("null", JournalError, "is damaged behind record {}: the next records do not fit those before"),
    ],
)
def test_a_record_that_cannot_be_replayed_is_named_with_its_place(
    text: str, error: type[PnmError], reason: str, scenario: tuple[Path, Counter[Code]], tmp_path: Path
) -> None:
    path = Path(shutil.copy(scenario[0], tmp_path / "journal"))
    with closing(KeptJournal(path)) as kept:
        number = kept.last_segment() + 4
    with forged(path) as file:
        file.execute("UPDATE records SET text = ? WHERE sequence = ?", (text, number))
    with pytest.raises(error, match=f"the journal {path} {reason.format(number - 1)}"):
        replayed(path, TASKS)
