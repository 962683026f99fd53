"""`pnm serve` that is killed while three goals are under way, over ROS 2: its robots and its clients are in other processes."""

from __future__ import annotations

from tests.support.tasks.kills.nodes import node_kills

KILLS = 20
NODES = 4
"""Side by side, each in a ROS domain of its own: they mostly wait."""


def test_three_goals_at_once_survive_many_kills_of_their_node() -> None:
    campaign = node_kills(KILLS, NODES)
    assert not campaign.wrong, "\n".join(campaign.wrong)
    assert campaign.kills >= KILLS
