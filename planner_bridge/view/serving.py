"""Serving the page: on this computer alone, until somebody ends it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from pnm.errors import InputError
from pnm.files.database.place import Place

if TYPE_CHECKING:
    from planner_bridge.view.control.route import Control

_HOST: Final = "127.0.0.1"


def listening(port: int) -> socket.socket:
    """Return a socket for the page, at a port of this computer; any that is free for 0.

    Raises:
        InputError: what serves the page is not installed, or the port is in use.
    """
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401, an extra, like starlette
    except ModuleNotFoundError as error:
        raise InputError(f"the page needs {error.name}, which is not there; pip install 'petri-net-machines[view]'") from error
    opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((_HOST, port))
        opened.listen()
    except OSError as error:
        opened.close()
        raise InputError(f"the page cannot be at port {port}: {error.strerror}; --view=0 takes any that is free") from error
    return opened


def url_of(opened: socket.socket) -> str:
    """Return where the page is."""
    return f"http://{_HOST}:{opened.getsockname()[1]}"


def serve_page(
    place: Place, opened: socket.socket, ended: Callable[[], Awaitable[object]] | None = None, control: Control | None = None
) -> None:
    """Serve the page of a journal at a socket until a signal ends it, or `ended` does; without `control` nothing can be controlled.

    A second signal, and one during a page that is slow, leave at once.
    """
    import uvicorn

    from planner_bridge.view.app import ViewApp
    from planner_bridge.view.control.route import NO_CONTROL
    from planner_bridge.view.follow import Feed, Reader

    class Server(uvicorn.Server):
        """Tells browsers that nothing more comes, so that they do not hold up the end."""

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            await feed.close()
            await super().shutdown(sockets)

    reader, past = Reader(place), Reader(place)
    feed = Feed(reader)
    app = ViewApp(place, feed, past, control or NO_CONTROL)
    config = uvicorn.Config(
        app.asgi, log_config=None, log_level="critical", access_log=False, lifespan="off", ws="none", server_header=False
    )
    server = Server(config)

    async def serve() -> None:
        async def wait() -> None:
            if ended is not None:
                await ended()
                server.should_exit = True

        waiting = asyncio.create_task(wait())
        try:
            await server.serve(sockets=[opened])
        finally:
            waiting.cancel()

    with suppress(KeyboardInterrupt):
        asyncio.run(serve())
    reader.close()
    past.close()
