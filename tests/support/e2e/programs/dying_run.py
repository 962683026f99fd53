"""`pnm run` that is killed after so many commits of its journal.

dying_run.py COMMITS ARGUMENTS...    of `pnm run`
"""

from __future__ import annotations

import sys

from planner_bridge.cli.commands import main
from tests.support.tasks.kills.instants import AtCommit, die_in_journals

die_in_journals(AtCommit(int(sys.argv.pop(1)), before=False))
sys.argv.insert(1, "run")
main()
