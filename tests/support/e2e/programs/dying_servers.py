"""`pnm` that is killed when its robots are asked for something the second time, without an answer."""

from __future__ import annotations

import os
import signal
from itertools import count

from planner_bridge.cli.commands import main
from planner_bridge.node.simulate import LoggedRobots
from pnm.core.machine.requests import Reporter, Request

_numbers = count(1)
_send = LoggedRobots.send


def _die_at_the_second(robots: LoggedRobots, request: Request, report: Reporter, /) -> None:
    if next(_numbers) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    _send(robots, request, report)


LoggedRobots.send = _die_at_the_second  # type: ignore[method-assign]
main()
