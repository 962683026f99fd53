"""`pnm run` that is killed after so many commits of its journal.

dying_run.py COMMITS ARGUMENTS...    of `pnm run`
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping, Sequence

from planner_bridge.cli.commands import main
from pnm.journal.store import JournalFile, Row

commits = int(sys.argv.pop(1))
append = JournalFile.append


def append_and_die(self: JournalFile, rows: Sequence[Row], parts: Mapping[str, str]) -> None:
    global commits
    append(self, rows, parts)
    commits -= 1
    if commits == 0:
        os.kill(os.getpid(), signal.SIGKILL)


JournalFile.append = append_and_die  # type: ignore[method-assign]
sys.argv.insert(1, "run")
main()
