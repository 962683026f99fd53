"""Long random runs: scenarios of many tasks, runs that are held, processes that die, broken machines, the reference, values, visitors.

usage: python -m tests.random_runs [--seeds 500] [--first 0] [--jobs 2] [--keep FOLDER] [KIND ...]

Kinds are scenarios, holds, deaths, chances, mutants, policies, forgotten, reference, values and visitors. The same number is the same
run. Without a kind, all are run: as many scenarios, holds, deaths, problems of several outcomes and machines as there are seeds, six
mutants of every machine, policies of as many problems and eight mutants of each and of its net, all machines without each trait of calls
that templates could forget, as many held against the reference, and as many against runs that are made from their values, and a visitor
for every tenth. The exit status is 1 if anything is wrong; every failure is printed with its number.
"""

from __future__ import annotations

import argparse
import gc
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path

from tests.support.e2e.mall.deployment import Mall
from tests.support.processes import ros_domain
from tests.support.runs.held_run import hold_against_reference, hold_against_values
from tests.support.runs.mutation.forgotten import TRAITS, run_forgotten
from tests.support.runs.mutation.gate import run_gate
from tests.support.runs.mutation.policies import run_policy_gate
from tests.support.tasks.scenarios.random_chances import run_chances
from tests.support.tasks.scenarios.random_deaths import run_deaths
from tests.support.tasks.scenarios.random_holds import run_holds
from tests.support.tasks.scenarios.random_scenarios import run_scenario

KINDS = ("scenarios", "holds", "deaths", "chances", "mutants", "policies", "forgotten", "reference", "values", "visitors")
GATES = {"mutants": run_gate, "policies": run_policy_gate}
TOO_LONG = 600


def failure_of(kind: str, number: int) -> str:
    """Run a scenario of this kind; return what was wrong, or nothing. One that hangs is wrong after `TOO_LONG` seconds."""
    signal.signal(signal.SIGALRM, signal.default_int_handler)  # what asyncio lets through
    signal.alarm(TOO_LONG)
    try:
        match kind:
            case "scenarios":
                run_scenario(number)
            case "holds":
                run_holds(number)
            case "reference":
                hold_against_reference(number)
            case "values":
                hold_against_values(number)
            case _:
                with tempfile.TemporaryDirectory() as folder:
                    (run_chances if kind == "chances" else run_deaths)(number, Path(folder))
    except (Exception, KeyboardInterrupt):
        return f"{kind} {number}\n{traceback.format_exc()}"
    finally:
        signal.alarm(0)
    return ""


def scenarios(kind: str, numbers: range, jobs: int) -> Iterator[str]:
    """Run scenarios, several at a time; yield the failures."""
    with ProcessPoolExecutor(jobs, initializer=gc.freeze) as pool:  # each looks for garbage at its end: what is loaded is none
        yield from filter(None, pool.map(partial(failure_of, kind), numbers, chunksize=5))


def false_accepts(kind: str, numbers: range) -> tuple[Counter[str], list[str]]:
    """Prove and execute a few machines, or policies, and their mutants; return the verdicts, and what was accepted and went wrong."""
    report = GATES[kind](numbers)
    return report.verdicts, report.false_accepts


def mutants(kind: str, numbers: range, jobs: int) -> Iterator[str]:
    """Put machines, or policies, through the mutation gate, several at a time; yield what was accepted falsely."""
    verdicts = Counter[str]()
    with ProcessPoolExecutor(jobs) as pool:
        parts = [numbers[first : first + 20] for first in range(0, len(numbers), 20)]
        for counted, wrong in pool.map(partial(false_accepts, kind), parts):
            verdicts += counted
            yield from wrong
    print(f"{kind}: {', '.join(f'{count} {verdict}' for verdict, count in sorted(verdicts.items()))}")


def forgotten(numbers: range, jobs: int) -> Iterator[str]:
    """Let templates forget each trait of calls, and none; yield the wrong machines that were proved, and the right ones that were not."""
    parts = [numbers[first : first + 500] for first in range(0, len(numbers), 500)]
    with ProcessPoolExecutor(jobs) as pool:
        begun = {trait: [pool.submit(run_forgotten, trait, part) for part in parts] for trait in ("", *TRAITS)}
        for trait, futures in begun.items():
            reports = [future.result() for future in futures]
            wrong, refused = sum(report.wrong for report in reports), sum(report.refused for report in reports)
            print(f"forgotten {trait or 'nothing'}: {wrong} wrong machines, {refused} times refused, by blocks or by name", flush=True)
            yield from (complaint for report in reports for complaint in report.complaints)


def visitors(numbers: range, keep: Path | None) -> Iterator[str]:
    """Run scripts of visitors one after the other; yield the verdict if there is anything to complain about."""
    with tempfile.TemporaryDirectory() as folder, ros_domain() as domain, closing(Mall(Path(folder), domain)) as mall:
        try:
            verdict = mall.execute(numbers)
        finally:
            if keep:
                mall.keep(keep)
    print(verdict)
    if verdict.wrong:
        yield f"visitors {numbers.start} to {numbers.stop - 1}: {len(verdict.wrong)} complaints"


def failures_of(kind: str, numbers: range, jobs: int, keep: Path | None) -> Iterator[str]:
    match kind:
        case "scenarios" | "holds" | "deaths" | "chances" | "reference" | "values":
            return scenarios(kind, numbers, jobs)
        case "mutants" | "policies":
            return mutants(kind, numbers, jobs)
        case "forgotten":
            return forgotten(numbers, jobs)
        case _:
            return visitors(numbers, keep)


def main() -> int:
    """Return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.random_runs", description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], metavar="KIND", help=f"{', '.join(KINDS)}; all without one")
    parser.add_argument("--seeds", type=int, default=500, help="how many of each; visitors are a tenth if not alone")
    parser.add_argument("--first", type=int, default=0, help="the number of the first one")
    parser.add_argument("--jobs", type=int, default=2, help="how many are run at the same time")
    parser.add_argument("--keep", type=Path, help="a folder for what the processes of the mall print")
    given = parser.parse_args()
    kinds = given.kinds or KINDS
    wrong = 0
    for kind in kinds:
        began = time.monotonic()
        count = given.seeds if kind != "visitors" or len(kinds) == 1 else max(1, given.seeds // 10)
        numbers = range(given.first, given.first + count)
        for failure in failures_of(kind, numbers, given.jobs, given.keep):
            print(failure)
            wrong += 1
        print(f"{count} {kind}: {time.monotonic() - began:.0f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
