"""A journal to look at, and one that grows as that one has grown."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from planner_bridge.pipeline.achieve import achieve
from pnm.actions.faults import read_faults
from tests.support.e2e.page.journals import GrowingJournal
from tests.support.files import ROOT


@pytest.fixture(scope="session")
def delivery(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a run in which a move fails four times: the plan goes on once, and there is a new one then."""
    journal = tmp_path_factory.mktemp("delivery") / "run.journal"
    domain, problems = ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery"
    result = achieve(domain, problems / "p01.pddl", faults=read_faults(problems / "faults.yaml", None), journal=journal)
    assert result.goal_reached
    assert result.replans == 2
    return journal


@pytest.fixture
def growing(delivery: Path, tmp_path: Path) -> Iterator[GrowingJournal]:
    journal = GrowingJournal(delivery, tmp_path / "growing.journal")
    yield journal
    journal.close()
