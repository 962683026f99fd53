"""Problems whose actions have several outcomes, played trial by trial: planner, machine, executor and a world that draws. Not a test.

usage: python -m tests.benchmarks.fond [--problems DIR] [--trials N] [--only GLOB] [--limit ACTIONS] [--seconds S]
                                       [--replanner | --policy-only] [--json FILE] [--write]

A folder has a manifest.json with the names of its problems, each a folder with domain.pddl and problem.pddl, and with figures that were
published for PRP and for a replanner (ffr), on other computers. The world reads PDDL by itself, draws each outcome, reports every change,
and judges whether the goal holds: a task that says so wrongly is a false success. A trial without an end within --seconds hangs, and one
of more actions than --limit has failed. Optima are of all states that can be reached, where these are at most 20,000.

`--replanner` asks a planner about the outcomes as actions to choose from, and again when another one happens: without policies.
`--policy-only` makes a policy once and plays it alone, without machine and executor. What is in the file of --json is not played again.
"""

from __future__ import annotations

import argparse
import json
import os
from fnmatch import fnmatch
from pathlib import Path
from typing import Final

from tests.support.files import SHARED
from tests.support.pddl.outcomes.play import Way, behind, fill, row

HEAD: Final = (
    "| problem | success | optimum | PRP | ffr | actions | optimum | PRP | planner calls | first action | ms an action | false | hangs |\n"
    f"|---|{'---:|' * 12}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description="problems whose actions have several outcomes")
    parser.add_argument("--problems", type=Path, default=SHARED / "fond", help="folder with manifest.json")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--only", default="*", help="names, with * and ?; several with commas")
    parser.add_argument("--limit", type=int, default=1000, help="actions of a trial")
    parser.add_argument("--seconds", type=float, default=60.0, help="of a trial, and of the optimum")
    ways = parser.add_mutually_exclusive_group()
    ways.add_argument("--replanner", action="store_true", help="without policies")
    parser.add_argument("--json", type=Path, help="keeps what was found; played is what is not in it yet")
    options = parser.parse_args()
    way = Way("replanner" if options.replanner else "whole", options.limit, options.seconds)
    kept = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    print(f"load {os.getloadavg()[0]:.1f}\n\n{HEAD}")
    late: dict[str, list[str]] = {}
    for pair in json.loads((options.problems / "manifest.json").read_text()):
        if any(fnmatch(pair["name"], pattern) for pattern in options.only.split(",")):
            found = kept.setdefault(pair["name"], {})
            fill(options.problems / pair["name"], way, options.trials, found)
            if options.json:
                options.json.write_text(json.dumps(kept))
            print(row(pair, found), flush=True)
            for who in behind(pair, found):
                late.setdefault(who, []).append(pair["name"])
    for who, names in late.items():
        print(f"\nbehind {who}: {', '.join(names)}")


if __name__ == "__main__":
    main()
