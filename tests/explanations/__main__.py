"""Random questions why, per domain, each answer checked: plans by both validators, what is impossible by a second planner.

usage: python -m tests.explanations [--questions 100] [--domain delivery] [--shared FOLDER] [--seed 0]

The exit status is 1 if an answer is false; every one that is false is printed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pnm.errors import PnmError
from tests.support.pddl.explanations.checked_claims import Checked
from tests.support.pddl.explanations.questions import ask, domains, read


def main() -> int:
    """Return 1 if anything was false."""
    parser = argparse.ArgumentParser(prog="python -m tests.explanations", description=__doc__.partition("\n")[0])
    parser.add_argument("--questions", type=int, default=100, help="how many for each domain")
    parser.add_argument("--domain", help="a part of the name of the domains that are asked about")
    parser.add_argument("--shared", type=Path, help="a folder of folders of pairs of domain.pddl and problem.pddl")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    given = parser.parse_args()
    wrong = 0
    for name, files in domains(given.shared).items():
        if given.domain and given.domain not in name:
            continue
        try:
            problems = read(files)
        except PnmError as error:
            print(f"{name}: not read: {error}")
            continue
        checked, clock, processor, longest = Checked(), 0.0, 0.0, ""
        for asked in ask(problems, given.questions, given.seed):
            before = len(checked.false)
            for answer in asked.answers:
                checked.look(answer)
            if asked.processor > processor:
                processor, longest = asked.processor, asked.text
            clock = max(clock, asked.seconds)
            for false in checked.false[before:]:
                print(f"  {name} {asked.text}: FALSE {false}", flush=True)
        wrong += len(checked.false)
        claims = ", ".join(f"{count} {kind}" for kind, count in sorted(checked.confirmed.items()))
        text = f"{name}: {given.questions} questions, {len(checked.false)} false; confirmed: {claims or 'nothing'}"
        print(f"{text}; {len(checked.unconfirmed)} beyond the second planner", flush=True)
        print(f"  longest {clock:.2f} s, {processor:.2f} s of the processor ({longest})", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
