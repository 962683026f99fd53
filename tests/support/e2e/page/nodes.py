"""Nodes whose page controls them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.support.e2e.deployment import ProblemDeployment
from tests.support.e2e.page.serving import announced
from tests.support.e2e.plan_deployment import Serving


@dataclass(frozen=True)
class Node:
    """A node whose page controls it, in whose world robots are at work."""

    url: str
    journal: Path

    @property
    def address(self) -> str:
        return self.url.partition("#")[0]


def serve(deployment: ProblemDeployment, *more: str) -> Node:
    deployment.simulate().ready()
    return begun(deployment, *more)[1]


def begun(deployment: ProblemDeployment, *more: str) -> tuple[Serving, Node]:
    """Start a node, or another one that goes on with its journal."""
    journal = deployment.folder / "node.journal"
    options = ["--view=0", "--view-controls", "--ask-for-help", "--journal", str(journal), *more]
    serving = deployment.pnm(Serving, "serve", *deployment.files, *options).ready()
    return serving, Node(announced(serving.err), journal)
