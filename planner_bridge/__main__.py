"""`python -m planner_bridge` is `pnm`: from here on Ctrl-C ends it in a sentence, also while the commands are being imported."""

import os
import sys

from pnm.signals import leave_at_ctrl_c

_PER_LINE = ("replay", "history")
"""Commands whose ``--json`` prints as many objects as there are things to tell, which may be none."""


def say_cancelled() -> None:
    """Say that a command was cancelled that has said nothing else: on stderr, and as the JSON object that ``--json`` asks for.

    Not by `print`: another thread may be in the middle of it.
    """
    os.write(2, b"cancelled\n")
    if "--json" in sys.argv and sys.argv[1] not in _PER_LINE:
        os.write(1, b'{"goal_reached": false, "code": "cancelled", "reason": "cancelled"}\n')


def main() -> None:
    """Run the command line."""
    leave_at_ctrl_c(say_cancelled)
    from planner_bridge.cli.commands import main

    main()


if __name__ == "__main__":
    main()
