"""`python -m planner_bridge` is `pnm`: from here on Ctrl-C ends it in a sentence, also while the commands are being imported."""

import os
import sys

from pnm.files.signals import leave_at_ctrl_c

UNTOLD = {
    "run": '"goal_reached": false, "code": "cancelled"',
    "goal": '"goal_reached": false, "code": 10',
    "plan": '"status": "cancelled", "steps": null',
    "odds": '"chance": null, "alone": null, "with_new_plans": null',
    "check": '"ready": null, "rows": null',
    "why": '"answers": null',
    "status": '"paused": null, "hands": null, "tasks": null',
    "facts": "",
}
"""The JSON of each command that was cancelled, beside the reason: its own keys, null for what it has not found out. `pnm replay` and
`pnm history` are not here: theirs has as many objects as there are things to tell, which may be none. Texts: nothing is imported yet."""


def say_cancelled() -> None:
    """Say that a command was cancelled that has said nothing else: on stderr, and as the JSON object that ``--json`` asks for.

    Not by `print`: another thread may be in the middle of it.
    """
    os.write(2, b"cancelled\n")
    if "--json" in sys.argv and (untold := UNTOLD.get(sys.argv[1])) is not None:
        os.write(sys.stdout.fileno(), f'{{{untold}{", " if untold else ""}"reason": "cancelled"}}\n'.encode())


def main() -> None:
    """Run the command line."""
    leave_at_ctrl_c(say_cancelled)
    from planner_bridge.cli.commands import main

    main()


if __name__ == "__main__":
    main()
