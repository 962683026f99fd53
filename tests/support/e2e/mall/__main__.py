"""Plays random scripts and judges them: ``python -m tests.support.e2e.mall --seeds 200``."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from tests.support.e2e.mall.deployment import Mall
from tests.support.ros.domains import ros_domain


def main() -> int:
    """Return 0 if there is nothing to complain about."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200, help="how many scripts")
    parser.add_argument("--first", type=int, default=0, help="the number of the first one")
    parser.add_argument("--keep", type=Path, help="a folder for what the processes printed")
    given = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, ros_domain() as domain, closing(Mall(Path(folder), domain)) as mall:
        try:
            verdict = mall.execute(range(given.first, given.first + given.seeds))
        finally:
            if given.keep:
                mall.keep(given.keep)
    print(f"{verdict}\n{time.monotonic() - began:.0f} s")
    return 1 if verdict.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
