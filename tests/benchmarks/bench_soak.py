"""Memory while tasks come and go, with a journal and without, in one process. Not a test.

usage: python -m tests.benchmarks.bench_soak [tasks]

Every 500 tasks, which are 10000 unless others are wanted: the memory of the process, and the number of our objects that are alive.
"""

from __future__ import annotations

import asyncio
import logging
import sys
import tempfile
from pathlib import Path

from pnm.clock import short_pauses
from tests.support.benchmarks.soak import memory, ours, tasks_in_a_row

OFTEN = 500


def told(number: int) -> None:
    """Print the memory of the process after so many tasks, and the number of our objects."""
    objects = ours().total()
    print(f"{number} tasks: {memory():.1f} MB, {objects} objects", flush=True)


async def soak(tasks: int, file: Path | None) -> None:
    async for number in tasks_in_a_row(file):
        if number % OFTEN == 0:
            told(number)
        if number == tasks:
            return


def main() -> None:
    logging.disable(logging.CRITICAL)
    tasks = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    with tempfile.TemporaryDirectory() as folder, short_pauses():
        for name, file in (("without a journal", None), ("with a journal", Path(folder) / "journal")):
            print(name)
            asyncio.run(soak(tasks, file))


if __name__ == "__main__":
    main()
