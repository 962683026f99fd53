"""Which PDDL problems are read, planned, translated and executed to the goal in simulation: a table in Markdown.

usage: python -m tests.benchmarks.planning.pairs [FOLDER ...] [--write]      (--write puts it into docs/reference/known-problems.md)

A folder has a manifest.json with the names of its pairs, each a folder with domain.pddl and problem.pddl. Every pair
has a process of its own and 60 seconds for everything. Times in the table are the plan's and the simulation's, in seconds.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.support.files import ROOT, SHARED

LIMIT = 60.0
KNOWN = SHARED / "pddl"
HEAD = "| problem | calls | planned | executed | remark |\n|---|---:|---:|---:|---|\n"


def do_pair(folder: Path) -> dict[str, Any]:
    """Do everything with one pair, in this process."""
    from planner_bridge import TaskObserver, achieve, load
    from planner_bridge.model.plan import Plan
    from pnm.errors import InputError

    class Watch(TaskObserver):
        def planned(self, plan: Plan) -> None:
            found.setdefault("planned", round(plan.makespan, 2) if plan.temporal else None)

    found: dict[str, Any] = {}
    try:
        problem = load(folder / "domain.pddl", folder / "problem.pddl")
    except InputError as error:
        where = f"{Path(error.position.file).name}:{error.position.line}:{error.position.column}: " if error.position else ""
        return {"is_read": False, "remark": f"refused: {where}{error.message}"}
    result = achieve(None, problem, observer=Watch())
    found["calls"] = len(result.calls)
    if problem.is_timed and result.calls:
        found["executed"] = round(max(call.ended or 0.0 for call in result.calls) - result.began, 2)
    warned = f"{len(problem.warnings)} warnings" if problem.warnings else ""
    remark = warned if result.goal_reached else result.reason.splitlines()[0]
    return found | {"is_read": True, "holds": result.goal_reached, "remark": remark}


def try_pair(folder: Path) -> dict[str, Any]:
    """Do everything with one pair, in a process that is stopped when its time is up."""
    command = [sys.executable, "-m", "tests.benchmarks.planning.pairs", "--one", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return {"remark": f"nothing within {LIMIT:g} s"}
    return json.loads(done.stdout) if done.returncode == 0 else {"remark": f"crashed: {done.stderr.splitlines()[-1]}"}  # type: ignore[no-any-return]


def pairs_table(folder: Path) -> str:
    """The table for one folder, and how many of its pairs reach the goal."""
    pairs = json.loads((folder / "manifest.json").read_text())
    found = {pair["name"]: try_pair(folder / pair["name"]) for pair in pairs}
    keys = ("calls", "planned", "executed", "remark")
    rows = [f"| {name} | {' | '.join(_cell(row.get(key)) for key in keys)} |\n" for name, row in found.items()]
    read, holds = (sum(row.get(key, False) for row in found.values()) for key in ("is_read", "holds"))
    return f"## {folder.name}: {read} of {len(found)} read, {holds} executed to the goal\n\n{HEAD}{''.join(rows)}\n"


def _cell(value: object) -> str:
    return "" if value is None else str(value).replace("|", "\\|")[:160]


def main() -> None:
    arguments = [one for one in sys.argv[1:] if not one.startswith("--")]
    if "--one" in sys.argv:
        print(json.dumps(do_pair(Path(arguments[0]))))
        return
    folders = [Path(name) for name in arguments] or [KNOWN / "robots", KNOWN / "ipc"]
    text = "# Known problems\n\nMade by `python -m tests.benchmarks.planning.pairs --write`. Every pair has a process of its own, and 60\n"
    text += "seconds for reading, planning, proving and executing. Times are the plan's and the simulation's, in seconds.\n"
    text += "A remark says what is wrong; else the files are read, the planner finds a plan, and the goal holds.\n\n"
    text += "\n".join(map(pairs_table, folders))
    if "--write" in sys.argv:
        (ROOT / "docs" / "reference" / "known-problems.md").write_text(text.rstrip("\n") + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
