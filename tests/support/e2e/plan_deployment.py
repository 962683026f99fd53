"""A world of plans that one process serves, action servers in others, and clients in yet others."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.support.e2e.deployment import RosDomain, Serving
from tests.support.files import written
from tests.support.processes import Program

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


class Workers(Program):
    """Action servers that say what they do, a JSON object per line."""

    def starts(self, server: str) -> list[Any]:
        """Return the values of the goals that a server has begun with, in order."""
        return [one["value"] for one in self.objects() if (one["event"], one["server"]) == ("start", server)]

    def happens(self, event: str, server: str, value: Any = None) -> None:
        """Wait until a goal has started, ended or was cancelled."""
        self.until(
            lambda: any((one["event"], one["server"]) == (event, server) and value in (None, one["value"]) for one in self.objects())
        )


class ClientProgram(Program):
    """A client of a plan's action server; prints what it hears, a JSON object per line."""

    def hears(self, event: str, **fields: Any) -> dict[str, Any]:
        """Wait for an event with these fields, and return it."""

        def found() -> dict[str, Any] | None:
            return next((one for one in self.objects() if one["event"] == event and fields.items() <= one.items()), None)

        return self.until(found) or {}

    def results(self) -> list[dict[str, Any]]:
        """Wait for its end, and return the results of its goals in the order in which these were sent."""
        assert self.ended() == 0, str(self)
        return sorted((one for one in self.objects() if one["event"] == "result"), key=lambda one: int(one["goal"]))

    def result(self) -> dict[str, Any]:
        """Return the only result."""
        (found,) = self.results()
        return found


class PlanDeployment(RosDomain):
    """Files with plans, who carries them out and who wants that; global knowledge is in a file of the deployment."""

    def __init__(self, folder: Path, ros_domain: int) -> None:
        super().__init__(folder, ros_domain, quick=True)
        self.knowledge = folder / "knowledge.sqlite"

    def write(self, files: Mapping[str, str]) -> None:
        """Write files with domains, plans and worlds."""
        for name, text in files.items():
            str(written(self.folder / name, text))

    def serve(self, *options: str, world: str = "world.yaml") -> Serving:
        """Start to serve a world."""
        files = ["--world", str(self.folder / world), "--knowledge", str(self.knowledge)]
        return self.pnm(Serving, "serve", *files, *options)

    def workers(self, *servers: str, script: str = "plain_servers") -> Workers:
        """Start action servers."""
        return self.module(Workers, f"tests.support.e2e.programs.{script}", *servers)

    def client(self, plan: str, *parameters: Mapping[str, Any] | str, cancel_on: str = "") -> ClientProgram:
        """Start a client that sends a goal for each of the parameters."""
        texts = [one if isinstance(one, str) else json.dumps(one) for one in parameters or ("",)]
        return self.module(ClientProgram, "tests.support.e2e.programs.client", "plan", plan, cancel_on, *texts)

    def cancel_all(self, server: str) -> None:
        """Have somebody cancel all goals of an action server."""
        assert self.module(Program, "tests.support.e2e.programs.client", "cancel", server).ended() == 0
