"""`pnm` whose `serve` has tasks that do as their goals say; run as a module with the arguments of `pnm`."""

from __future__ import annotations

from planner_bridge.cli.commands import main
from planner_bridge.node import serve as serving
from tests.support.tasks.fake_tasks import make_fake_tasks

if __name__ == "__main__":
    serving.make_task_manager = make_fake_tasks
    main()
