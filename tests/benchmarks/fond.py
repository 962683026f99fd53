"""Problems whose actions have several outcomes, played trial by trial: planner, machine, executor and a world that draws. Not a test.

usage: python -m tests.benchmarks.fond [--problems DIR] [--trials N] [--only GLOB] [--limit ACTIONS] [--seconds S]
                                       [--replanner | --policy-only] [--json FILE] [--write]

A folder has a manifest.json with the names of its problems, each a folder with domain.pddl and problem.pddl, and with figures that were
published for PRP and for a replanner (ffr), on other computers. The world reads PDDL by itself, draws each outcome, reports every change,
and judges whether the goal holds: a task that says so wrongly is a false success. A trial without an end within ten times --seconds hangs,
and one of more actions than --limit has failed. Each search of a planner may take half of --seconds. Optima are of all states that can be
reached, where these are at most 20,000.

`--replanner` asks a planner about the outcomes as actions to choose from, and again when another one happens: without policies.
`--policy-only` makes a policy once and plays it alone, without machine and executor; where there is none, no goal is reached. What was
found for a state is kept for all trials of a problem: the first action and the closed policy are those of the first trial. What is in the
file of --json is not played again; the file is written every few seconds, and with `--trials 0` it is only read.
`--write` puts a summary of what was played, set by set, into docs/reference/benchmarks.md.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path
from statistics import median
from typing import Any, Final

from tests.support.files import ROOT, SHARED
from tests.support.pddl.outcomes.play import HANGS, Way, behind, fill, published, row

HEAD: Final = (
    "| problem | success | optimum | PRP | ffr | actions | optimum | PRP | searches | first action | closed | PRP | entries | PRP "
    f"| ms an action | false | hangs |\n|---|{'---:|' * 16}"
)
SAVED_EVERY: Final = 5.0
"""Seconds between two savings of what was found."""
WAYS: Final = {"whole": "planner, machine and executor", "policy": "the policy alone", "replanner": "without policies"}
PAGE: Final = ROOT / "docs" / "reference" / "benchmarks.md"
BEGIN: Final = "<!-- measured: python -m tests.benchmarks.fond --write -->\n"
END: Final = "<!-- end of what is played -->\n"
SETS: Final = (
    "| set | problems | success | PRP | ffr | behind PRP, ffr, optimum | actions by PRP's | first action "
    f"| closed in time | false | hangs |\n|---|{'---:|' * 10}"
)


def row_of_set(name: str, played: Mapping[str, tuple[dict[str, Any], dict[str, Any]]]) -> str:
    """Return the line of a set: rates of success are means over its problems, those of others over the ones that they published."""

    def rate(who: str) -> str:
        known = [float(figure) for pair, _ in played.values() if (figure := published(pair, who, "succeeded"))]
        return f"{sum(known) / len(known):.0f} % of {len(known)}" if known else ""

    founds = [found for _, found in played.values()]
    trials = [one for found in founds for one in found["trials"]]
    share = sum(sum(one["reached"] for one in found["trials"]) / max(1, len(found["trials"])) for found in founds) / len(founds)
    late = [who for pair, found in played.values() for who in behind(pair, found)]
    longer, firsts, in_time = list[float](), list[float](), list[bool]()
    for pair, found in played.values():
        good = [one["actions"] for one in found["trials"] if one["reached"]]
        if good and float(published(pair, "prp", "actions") or 0.0):
            longer.append(sum(good) / len(good) / float(published(pair, "prp", "actions")))
        firsts += [found["read"] + one["first"] for one in found["trials"][:1] if one.get("first") is not None]
        if "closed" in found:
            in_time.append(found["closed"] <= max(2.0, float(published(pair, "prp", "runtime") or 0.0)))
    cells = (
        len(founds),
        f"{100 * share:.1f} %",
        *(rate(who) for who in ("prp", "ffr")),
        ", ".join(str(late.count(who)) for who in ("prp", "ffr", "the optimum")),
        f"{median(longer):.2f}" if longer else "",
        f"{sorted(firsts)[int(0.9 * (len(firsts) - 1))]:.2f} s" if firsts else "",
        f"{sum(in_time)} of {len(in_time)}" if in_time else "",
        sum(one["claimed"] and not one["reached"] for one in trials),
        sum(one["why"] == HANGS for one in trials),
    )
    return f"| {name} | {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="problems whose actions have several outcomes")
    parser.add_argument("--problems", type=Path, default=SHARED / "fond", help="folder with manifest.json")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--only", default="*", help="names, with * and ?; several with commas")
    parser.add_argument("--limit", type=int, default=1000, help="actions of a trial")
    parser.add_argument("--seconds", type=float, default=60.0, help="of two searches, and of the optimum")
    ways = parser.add_mutually_exclusive_group()
    ways.add_argument("--replanner", action="store_true", help="without policies")
    ways.add_argument("--policy-only", action="store_true", help="without machine and executor")
    parser.add_argument("--json", type=Path, help="keeps what was found; played is what is not in it yet")
    parser.add_argument("--write", action="store_true", help=f"put the summary into {PAGE.name}")
    options = parser.parse_args()
    way = Way("replanner" if options.replanner else "policy" if options.policy_only else "whole", options.limit, options.seconds)
    kept = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    print(f"load {os.getloadavg()[0]:.1f}\n\n{HEAD}")
    saved = time.monotonic()
    sets: dict[str, dict[str, tuple[dict[str, Any], dict[str, Any]]]] = {}
    for pair in json.loads((options.problems / "manifest.json").read_text()):
        if any(fnmatch(pair["name"], pattern) for pattern in options.only.split(",")):
            found = kept.setdefault(pair["name"], {})
            for _ in fill(options.problems / pair["name"], way, options.trials, found):
                if options.json and time.monotonic() > saved + SAVED_EVERY:
                    options.json.write_text(json.dumps(kept))
                    saved = time.monotonic()
            if options.json:
                options.json.write_text(json.dumps(kept))
            print(row(pair, found), flush=True)
            sets.setdefault(pair.get("set", "cases"), {})[pair["name"]] = pair, found
    every = {name: one for played in sets.values() for name, one in played.items()}
    for who in ("prp", "ffr", "the optimum"):
        if names := [name for name, one in every.items() if who in behind(*one)]:
            print(f"\nbehind {who}: {', '.join(names)}")
    rows = [row_of_set(name, played) for name, played in sets.items()] + ([row_of_set("all", every)] if len(sets) > 1 else [])
    table = "\n".join((SETS, *rows))
    print(f"\n{table}")
    if options.write:
        before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
        counts = sorted({len(found["trials"]) for _, found in every.values()})
        told = f"{WAYS[way.way]}, {' or '.join(map(str, counts))} trials of a problem"
        PAGE.write_text(f"{before}{BEGIN}\nMeasured: {told}.\n\n{table}\n\n{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
