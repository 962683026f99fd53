"""`pnm serve` with tasks that do as their goals say, and its clients."""

from __future__ import annotations

from tests.support.e2e.plan_deployment import ClientProgram, PlanDeployment, Serving
from tests.support.files import ROOT

DOMAIN, PROBLEM = str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl")


PAGE = (ROOT / "docs" / "guides" / "serving.md").read_text(encoding="utf-8")


def serve(deployment: PlanDeployment, *arguments: str) -> Serving:
    return deployment.module(Serving, "tests.support.e2e.programs.fake_serve", "serve", *arguments)


def goals(deployment: PlanDeployment, *texts: str) -> ClientProgram:
    return deployment.module(ClientProgram, "tests.support.e2e.programs.client", "goals", *texts)


def transitions(deployment: PlanDeployment, *labels: str) -> list[bool]:
    """Ask for transitions; return which of them were made."""
    client = deployment.module(ClientProgram, "tests.support.e2e.programs.client", "change", *labels)
    assert client.ended() == 0, str(client)
    return [one["success"] for one in client.objects() if one["event"] == "changed"]
