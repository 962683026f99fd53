"""Many crashes of a PostgreSQL whose commits are not durable: killed processes and immediate stops, in turn.

usage: python -m tests.pnm.journal.holding [--crashes 100] [--first 0]

After each crash the journal must have all that was acknowledged, in order, and nothing else. The exit status is 1 if it has not.
"""

from __future__ import annotations

import argparse
import sys

from pnm.files.database.place import place_of
from tests.support.e2e.hosts.crashes import kill, stop, survive
from tests.support.e2e.hosts.postgres import postgres_server

AT_ONCE = 10
"""Crashes that a journal has."""


def main() -> int:
    """Return 0 if nothing was lost."""
    parser = argparse.ArgumentParser(prog="python -m tests.pnm.journal.holding", description=__doc__.partition("\n")[0])
    parser.add_argument("--crashes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    given = parser.parse_args()
    lost = 0
    with postgres_server() as server:
        for number in range(given.crashes // AT_ONCE):
            seed = given.first + number
            lost += survive(place_of(server.database()), server, (kill, stop)[seed % 2], seed, AT_ONCE)
            print(
                f"{(number + 1) * AT_ONCE} crashes, {lost} acknowledged records forgotten by the server and written again, none missing",
                flush=True,
            )
    return 0


sys.exit(main())
