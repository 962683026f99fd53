"""Two nodes on two hosts and one PostgreSQL: whatever happens to the one that serves, the other one goes on with its tasks."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.support.e2e.hosts.lan import why_not
from tests.support.e2e.hosts.nodes import fleet
from tests.support.e2e.hosts.rounds import Harm, Rounds

ALONE = why_not()
pytestmark = pytest.mark.skipif(bool(ALONE), reason=ALONE)


def test_a_node_that_is_killed_cut_off_or_stopped_is_taken_over_and_sends_nothing_any_more(tmp_path: Path) -> None:
    with fleet(tmp_path) as deployment:
        rounds = Rounds(deployment)
        for harm in Harm:
            rounds.play(harm)
        rounds.check()


def test_a_node_that_stands_by_ends_at_once_and_one_that_is_shut_down_lets_the_journal_go(tmp_path: Path) -> None:
    with fleet(tmp_path, lease=1000.0) as deployment:
        first, waiting = deployment.serve("one").ready(), deployment.serve("two")
        waiting.until(lambda: waiting.stands_by)
        waiting.stop(signal.SIGINT)
        second = deployment.serve("two")
        second.until(lambda: second.stands_by)
        first.stop()
        second.ready()
