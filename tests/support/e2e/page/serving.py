"""Pages of journals, served in this process, and requests to them."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
from planner_bridge.view.app import NO_CONTROL, serve_page
from planner_bridge.view.serving import listening, url_of
from tests.support.processes import LIMIT


@contextmanager
def page_of(journal: Path, known: KnownRobots = NOTHING_KNOWN) -> Iterator[str]:
    """Serve the page of a journal, with odds by what is known of robots; yield where it is."""
    opened, over = listening(0), threading.Event()
    url = url_of(opened)
    serving = threading.Thread(target=serve_page, args=(journal, opened, lambda: asyncio.to_thread(over.wait), NO_CONTROL, known))
    serving.start()
    try:
        yield url
    finally:
        over.set()
        serving.join(LIMIT)
        assert not serving.is_alive()


def announced(lines: Sequence[str]) -> str:
    """The URL of a page that a command has announced, with its token if it has one: that is in a file, for the lines are no terminal's."""
    line = next(line for line in lines if line.startswith("view "))
    kept = re.search(r"is in (\S+), which only you can read", line)
    return Path(kept[1]).read_text().strip() if kept else line.split()[1]


class Stream:
    """The frames that a browser would get."""

    def __init__(self, url: str, path: str = "/events", headers: Mapping[str, str] | None = None) -> None:
        self._connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=LIMIT)
        self._connection.request("GET", path, headers=dict(headers or {}))
        self._response = self._connection.getresponse()
        assert self._response.status == 200
        assert self._response.getheader("content-type", "").startswith("text/event-stream")

    def next(self) -> tuple[str, dict[str, Any]]:
        """Wait for the next frame; return its id and what it says."""
        fields: dict[str, str] = {}
        while line := self._response.readline():
            name, _, value = line.decode().rstrip("\n").partition(": ")
            if not name and "data" in fields:
                return fields["id"], json.loads(fields["data"])
            fields[name] = value
        raise EOFError("the stream has ended")

    def close(self) -> None:
        self._response.close()
        self._connection.close()


def asked(url: str, path: str, method: str = "GET", body: str | None = None, **headers: str) -> tuple[int, Mapping[str, str], str]:
    """Return status, headers and text of an answer."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=LIMIT)
    try:
        connection.request(method, path, body, headers)
        response = connection.getresponse()
        return response.status, {name.lower(): value for name, value in response.getheaders()}, response.read().decode()
    finally:
        connection.close()
