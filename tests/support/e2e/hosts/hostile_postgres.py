"""A server that speaks PostgreSQL's protocol until a connection has begun, and then whatever a test has it send."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Final

WAITED: Final = 30.0
"""Seconds after which something hangs: limits are set below."""


def in_time(work: Callable[[], object]) -> object:
    """Return what a function does in a thread of its own; it hangs if it takes long."""
    future: Future[object] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future.result(WAITED)


@contextmanager
def serving(answer: Callable[[socket.socket], None]) -> Iterator[str]:
    """Serve whoever connects, once encryption is refused and the connection begun; yield the URL."""

    def serve() -> None:
        with suppress(OSError):
            while True:
                client, _ = listening.accept()
                threading.Thread(target=serve_one, args=(client,), daemon=True).start()

    def serve_one(client: socket.socket) -> None:
        with suppress(OSError), client:
            client.recv(8)
            client.sendall(b"N")
            client.recv(4096)
            client.sendall(b"R" + struct.pack("!II", 8, 0))
            answer(client)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=serve, daemon=True).start()
        yield f"postgresql://pnm@127.0.0.1:{listening.getsockname()[1]}/db"
