"""Processes that are killed while simulated robots go on in another one: whatever the instant, each task has its true end.

`python -m tests.e2e.kills` does the same for as long as you like.
"""

from __future__ import annotations

from tests.support.tasks.kills.campaign import kills_at_every_commit, random_kills

KILLS = 60
JOBS = 2


def test_tasks_survive_many_kills() -> None:
    campaign = random_kills(KILLS, JOBS)
    assert not campaign.wrong, "\n".join(campaign.wrong)
    assert campaign.kills >= KILLS


def test_tasks_survive_a_kill_before_and_after_every_commit() -> None:
    campaign = kills_at_every_commit(JOBS)
    assert not campaign.wrong, "\n".join(campaign.wrong)
    assert campaign.kills > 60
