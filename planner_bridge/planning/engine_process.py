"""The engine process: reads the problem from its folder, asks one engine for a plan, writes the answer.

usage: python -m planner_bridge.planning.engine_process ENGINE [SECONDS]; without them, it only looks up the engine
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import ModuleType

from planner_bridge.planning.engines import ANSWER, BEGAN, die_with_parent


def main() -> None:
    """Ask one engine for a plan, and write its answer, atomically, to answer.json."""
    die_with_parent()
    stub = ModuleType("ConfigSpace")  # it and scipy would be loaded for one annotation, in 60 % of the time to load unified-planning
    stub.ConfigurationSpace = object  # type: ignore[attr-defined]
    sys.modules[stub.__name__] = stub
    from planner_bridge.planning.unified_planning import ask, look_up  # here, because it takes long and needs the stub

    Path(BEGAN).touch()
    answer = ask(sys.argv[1], float(sys.argv[2])) if len(sys.argv) > 2 else look_up(sys.argv[1])
    Path("answer").write_text(json.dumps(answer))
    os.replace("answer", ANSWER)  # atomic: a reader sees no half-written answer


if __name__ == "__main__":
    main()
