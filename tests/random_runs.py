"""Long random runs: scenarios of many tasks in simulation, and visitors of the mall over ROS 2. The same number is the same run.

usage: python -m tests.random_runs [--seeds 500] [--first 0] [--jobs 2] [--keep FOLDER] [scenarios] [visitors]

Without a kind, both are run: as many scenarios as there are seeds, and a visitor for every tenth. The exit status is 1 if anything is
wrong, and every failure is printed with its number.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path

from tests.support.e2e.mall.deployment import Mall
from tests.support.ros.domains import ros_domain
from tests.support.tasks.random_scenarios import run_scenario

KINDS = ("scenarios", "visitors")


def failure(number: int) -> str:
    """Run a scenario; return what was wrong, or nothing."""
    try:
        run_scenario(number)
    except Exception:
        return f"scenario {number}\n{traceback.format_exc()}"
    return ""


def scenarios(numbers: range, jobs: int) -> Iterator[str]:
    """Run scenarios, several at a time; yield the failures."""
    with ProcessPoolExecutor(jobs) as pool:
        yield from filter(None, pool.map(failure, numbers, chunksize=5))


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


def main() -> int:
    """Return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.random_runs", description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], metavar="KIND", help="scenarios or visitors; both if there is none")
    parser.add_argument("--seeds", type=int, default=500, help="how many scenarios; visitors are a tenth unless they alone are run")
    parser.add_argument("--first", type=int, default=0, help="the number of the first one")
    parser.add_argument("--jobs", type=int, default=2, help="how many scenarios are run at the same time")
    parser.add_argument("--keep", type=Path, help="a folder for what the processes of the mall print")
    given = parser.parse_args()
    kinds = given.kinds or KINDS
    wrong = 0
    for kind in kinds:
        began = time.monotonic()
        count = given.seeds if kind == "scenarios" or len(kinds) == 1 else max(1, given.seeds // 10)
        numbers = range(given.first, given.first + count)
        for found in scenarios(numbers, given.jobs) if kind == "scenarios" else visitors(numbers, given.keep):
            print(found)
            wrong += 1
        print(f"{count} {kind}: {time.monotonic() - began:.0f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
