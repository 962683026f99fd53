"""The engine process: reads the problem from its folder, asks one engine for a plan, writes the answer.

usage: python -m planner_bridge.planning.unified_planning ENGINE [SECONDS]; without them, it only looks up the engine
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import ModuleType

from planner_bridge.planning.engine_process import ANSWER, BEGAN, die_with_parent


def main() -> None:
    """Ask one engine for a plan, and write its answer, atomically, to answer.json."""
    die_with_parent()
    _stub_config_space()
    from planner_bridge.planning.unified_planning.engine import (  # here, because it takes long, and the stub must be there before
        ask,
        look_up,
    )

    Path(BEGAN).touch()
    answer = ask(sys.argv[1], float(sys.argv[2])) if len(sys.argv) > 2 else look_up(sys.argv[1])
    Path("answer").write_text(json.dumps(answer))
    os.replace("answer", ANSWER)  # atomic: a reader sees no half-written answer


def _stub_config_space() -> None:
    """Keep unified-planning from loading ConfigSpace and scipy for one annotation, which is 60 % of the time to load it."""
    stub = ModuleType("ConfigSpace")
    stub.ConfigurationSpace = object  # type: ignore[attr-defined]
    sys.modules[stub.__name__] = stub


if __name__ == "__main__":
    main()
