"""`pnm` whose `serve` has tasks that do as their goals say; run as a module with the arguments of `pnm`."""

from __future__ import annotations

from planner_bridge.cli.commands import main
from planner_bridge.node import serve as serving
from tests.support.tasks.scripted_tasks import open_scripted

if __name__ == "__main__":
    serving.make_task_manager = open_scripted
    main()
