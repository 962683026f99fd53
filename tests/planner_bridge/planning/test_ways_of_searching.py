"""One search of Kairos finds simple plans, the same every time; where it finds none soon, other ways of searching join it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import kairos
import pytest

from planner_bridge.model.plan import PlanningStatus
from planner_bridge.planning import kairos as module
from planner_bridge.planning.kairos import parse_for_kairos
from planner_bridge.planning.solve import solve
from tests.support.pddl.problems import hard, rooms
from tests.support.processes import until


class Planner(kairos.Planner):
    """Kairos on a bad day: its own way of searching does not get anywhere. The searches and their options are noted."""

    searches: list[kairos.Search]
    options: list[dict[str, Any]]

    def start(self, problem: kairos.Problem, **options: Any) -> kairos.Search:  # type: ignore[override]
        search: kairos.Search = super().start(problem if "search" in options else parse_for_kairos(hard()), **options)
        self.searches.append(search)
        self.options.append(options)
        return search


@pytest.fixture(autouse=True)
def noted(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Planner]]:
    monkeypatch.setattr(kairos, "Planner", Planner)
    monkeypatch.setattr(module, "_PATIENCE", 0.05)
    Planner.searches, Planner.options = [], []
    yield Planner
    Planner.searches.clear()  # they are stopped when they go away


def test_what_one_way_of_searching_does_not_find_another_one_does() -> None:
    found = solve(rooms(), timeout=60.0, improve=0.04)
    assert found.plan is not None
    assert found.planner == "kairos"


def test_who_asks_for_the_first_plan_of_one_search_gets_no_other(noted: type[Planner]) -> None:
    assert solve(rooms(), timeout=0.5, improve=0.0).status is PlanningStatus.TIMED_OUT
    assert len(noted.searches) == 1


def test_a_simple_problem_has_one_search_until_there_is_a_plan(monkeypatch: pytest.MonkeyPatch, noted: type[Planner]) -> None:
    monkeypatch.setattr(module, "_PATIENCE", 60.0)
    assert solve(rooms(), timeout=0.5).status is PlanningStatus.TIMED_OUT
    assert [options["threads"] for options in noted.options] == [1]


def test_all_searches_together_keep_to_the_limits_and_are_cancelled(noted: type[Planner]) -> None:
    cancel = threading.Event()
    threading.Thread(target=lambda: (until(lambda: len(noted.searches) == 4), cancel.set())).start()
    assert solve(hard(), timeout=600.0, cancel=cancel).status is PlanningStatus.CANCELLED
    until(lambda: not any(search.running() for search in noted.searches))
    first, *others = noted.options
    assert {options["search"] for options in others} == {"ehc", "goals", "novelty"}
    assert all(options["threads"] == 1 and options["timeout"] <= first["timeout"] for options in others)
    half = Planner().solve(parse_for_kairos(rooms())).stats.memory_limit_bytes / 2**20
    assert sum(options["memory_limit_mb"] for options in others) < 1.2 * half  # what is available changes a little
