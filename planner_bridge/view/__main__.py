"""`python -m planner_bridge.view PORT WHAT` is the page in a process of its own; see `planner_bridge.view.serving`."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from planner_bridge.view.serving import Controlled, listening, url_of
from pnm.errors import InputError
from pnm.files.database.place import place_of
from pnm.files.process import make_streams_safe, own_standard_output

if TYPE_CHECKING:
    from planner_bridge.view.app import Channel

_NICE: Final = 10
"""The priority of this process below others: processes that drive robots come first on a busy machine."""


def main() -> int:
    """Say where the page is, or what is wrong; read which journal it shows; serve until whoever writes that has gone."""
    own_standard_output()
    make_streams_safe()
    os.nice(_NICE)
    controlled = Controlled(sys.argv[2])
    try:
        opened = listening(int(sys.argv[1]))
    except InputError as error:
        sys.stdout.write(f"{error}\n")
        return 2
    token = secrets.token_urlsafe(32)
    _write(url_of(opened) + ("" if controlled is Controlled.NOTHING else f"/#token={token}"))
    if line := sys.stdin.readline():
        # here, because what it needs is an extra, which is there by now
        from planner_bridge.pipeline.loading import known_from
        from planner_bridge.pipeline.odds import NOTHING_KNOWN
        from planner_bridge.view.app import Channel, Control, serve_page

        channel, told = Channel(_write), json.loads(line)
        control, known = Control(controlled, token, channel), NOTHING_KNOWN
        with suppress(InputError):  # the command says what is wrong
            known = known_from(told["rates"], told["faults"])
        serve_page(place_of(told["journal"]), opened, lambda: _left_alone(channel), control, known)
    return 0


def _write(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


async def _left_alone(channel: Channel) -> None:
    """Take in replies until the other end of the input is closed: by the process that has started this one, or by its death."""
    loop, is_closed = asyncio.get_running_loop(), asyncio.Event()

    def read() -> None:
        with suppress(RuntimeError):  # the loop is over already
            for line in sys.stdin:
                loop.call_soon_threadsafe(channel.hear, line)
            loop.call_soon_threadsafe(is_closed.set)

    threading.Thread(target=read, daemon=True).start()
    await is_closed.wait()


if __name__ == "__main__":
    sys.exit(main())
