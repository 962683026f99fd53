"""The child process: reads the problem where it stands, asks one engine for a plan, writes its answer.

usage: python -m planner_bridge.planning.unified_planning ENGINE [SECONDS]; without them, it only tells whether there is such an engine
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import ModuleType

from planner_bridge.planning.engine_process import ANSWER, BEGAN, die_with_parent


def main() -> None:
    """Answer, whatever comes."""
    die_with_parent()
    _spare_what_nobody_uses()
    from planner_bridge.planning.unified_planning.engine import (  # here, because it takes long, and what was spared must be so before
        ask,
        look_for,
    )

    Path(BEGAN).touch()
    answer = ask(sys.argv[1], float(sys.argv[2])) if len(sys.argv) > 2 else look_for(sys.argv[1])
    Path("answer").write_text(json.dumps(answer))
    os.replace("answer", ANSWER)  # whoever sees it, sees all of it


def _spare_what_nobody_uses() -> None:
    """Keep unified-planning from loading ConfigSpace and scipy, for the sake of one annotation: 60 % of the time to load it."""
    spared = ModuleType("ConfigSpace")
    spared.ConfigurationSpace = object  # type: ignore[attr-defined]
    sys.modules[spared.__name__] = spared


if __name__ == "__main__":
    main()
