"""`pnm serve` with tasks that do as their goals say, and its clients."""

from __future__ import annotations

from tests.support.e2e.plans import Client, PlanScene, Serving
from tests.support.e2e.processes import ROOT

DOMAIN, PROBLEM = str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl")


PAGE = (ROOT / "docs" / "serving.md").read_text(encoding="utf-8")


def serve(scene: PlanScene, *arguments: str) -> Serving:
    return scene.start(Serving(["-m", "tests.support.e2e.scripted_serve", "serve", *arguments], scene.environment))


def goals(scene: PlanScene, *texts: str) -> Client:
    return scene.start(Client(["-m", "tests.support.e2e.goal_client", "send", *texts], scene.environment))


def change(scene: PlanScene, *labels: str) -> list[bool]:
    """Ask for transitions; return which of them were made."""
    client = scene.start(Client(["-m", "tests.support.e2e.goal_client", "change", *labels], scene.environment))
    assert client.ended() == 0, str(client)
    return [one["success"] for one in client.objects() if one["event"] == "changed"]
