"""`python -m planner_bridge.view PORT` is the page in a process of its own; see `planner_bridge.view.process`."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
from contextlib import suppress

from planner_bridge.view.serving import listening, serve_page, url_of
from pnm.errors import InputError
from pnm.files.database.place import place_of


def main() -> int:
    """Say where the page is, or what is wrong; read which journal it shows; serve until whoever writes that has gone."""
    try:
        opened = listening(int(sys.argv[1]))
    except InputError as error:
        sys.stdout.write(f"{error}\n")
        return 2
    sys.stdout.write(f"{url_of(opened)}\n")
    sys.stdout.flush()
    if line := sys.stdin.readline():
        serve_page(place_of(json.loads(line)), opened, _left_alone)
    return 0


async def _left_alone() -> None:
    """Wait until the other end of the input is closed: by the process that has started this one, or by its death."""
    loop, is_closed = asyncio.get_running_loop(), asyncio.Event()

    def read() -> None:
        sys.stdin.read()
        with suppress(RuntimeError):  # the loop is over already
            loop.call_soon_threadsafe(is_closed.set)

    threading.Thread(target=read, daemon=True).start()
    await is_closed.wait()


if __name__ == "__main__":
    sys.exit(main())
