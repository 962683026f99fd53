"""PostgreSQL as a database of ours.

Nothing waits without limit: neither for the server, which may be cut off, nor for another process that writes. A process that stops in
the middle of a transaction loses it within `LIMIT` seconds, so that others need not wait for it. A server whose answers have no end
is heard no longer, and no further, than the limit of an operation allows.
"""

from __future__ import annotations

import select
import socket
import ssl
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from pnm.errors import not_installed
from pnm.files.database.driver import DatabaseError, Driver, Layout, OperationLimit, Rows, check_version
from pnm.files.database.place import ServerUrl

LIMIT: Final = 1.0
"""Seconds to wait for a server: to reach it, and for each of its answers."""
_SILENT: Final = 5.0
"""Seconds after which a connection that waits is dead: it asks more often."""
_NAME: Final = 63
"""Bytes of the name of a connection."""
MAKING: Final = 0x504E4D
"""The lock of those that make tables."""
_ASK_FOR_SSL: Final = bytes.fromhex("00000008 04d2162f")
"""The request with which encryption begins, of PostgreSQL's protocol."""
_WORDS: Final = 1000
"""Characters of what a server says is wrong."""
_NONSENSE: Final = "the server does not speak PostgreSQL's protocol"


class _Limited(socket.socket):
    """A socket that waits within the limit of an operation, set as its attribute."""

    limit: OperationLimit

    def recv_into(self, *arguments: Any, **options: Any) -> int:
        """Receive into a buffer."""
        self.settimeout(min(LIMIT, self.limit.seconds()))
        size = super().recv_into(*arguments, **options)
        self.limit.take(size)
        return size

    def send(self, *arguments: Any, **options: Any) -> int:
        """Send what can be sent of some data."""
        self.settimeout(min(LIMIT, self.limit.seconds()))
        return super().send(*arguments, **options)


class _LimitedSsl(_Limited, ssl.SSLSocket):
    """The same, encrypted."""


class Postgres(Driver):
    """Tables in a schema of a PostgreSQL database."""

    survives = False

    def __init__(self, url: ServerUrl, limit: OperationLimit, *, read_only: bool, is_durable: bool) -> None:
        try:
            from pg8000.native import Connection
        except ImportError as error:
            raise not_installed("PostgreSQL", error, "postgres") from error
        ended = f"{LIMIT * 1000:.0f}"
        settings = {
            "search_path": url.name,
            "synchronous_commit": "on" if is_durable else "off",
            "default_transaction_read_only": "on" if read_only else "off",
            **dict.fromkeys(("statement_timeout", "lock_timeout", "idle_in_transaction_session_timeout"), ended),
        }
        self._limit = limit
        self._socket = _connected(url, limit)
        try:
            self._connection = Connection(
                url.user,
                host=url.host,
                database=url.database,
                password=url.password or "",  # without any, some ways to ask for it fail in the driver
                sock=self._socket,
                ssl_context=False,  # it is encrypted already, if it shall be
                application_name="pnm",
                startup_params=settings,
            )
        except BaseException:
            self._socket.close()
            raise
        self._name = url.name
        self._waits = f"{url.name[:20]} waits: "
        """The beginning of the names of connections that wait for notices here."""
        self._statements: dict[str, Any] = {}
        self._listens = False

    @staticmethod
    def said(error: Exception) -> DatabaseError:
        """Return the words of the server, the driver or the network; any other exception comes of an answer without sense."""
        from pg8000.exceptions import Error
        from scramp import ScramException  # of the proof of a password

        match error:
            case Error(args=(str(words), *_)) if "stream" in words:  # the server copies something, which nobody has asked for
                return DatabaseError(_NONSENSE)
            case Error(args=({"M": str(words)}, *_)) | Error(args=(str(words), *_)) | ScramException(args=(str(words), *_)):
                return DatabaseError(words[:_WORDS])
            case OSError():
                return DatabaseError(str(error) or type(error).__name__)
        return DatabaseError(_NONSENSE)

    def run(self, sql: str, values: Mapping[str, object], /) -> Rows:
        """Execute a statement with ``:name`` parameters."""
        if not values:
            return self._connection.run(sql) or []
        return self._statement(sql).run(**values) or []

    def run_many(self, sql: str, rows: Sequence[Mapping[str, object]], /) -> None:
        """Execute a statement for each row."""
        statement = self._statement(sql)
        for row in rows:
            statement.run(**row)

    def _statement(self, sql: str) -> Any:
        if sql not in self._statements:
            self._statements[sql] = self._connection.prepare(sql)
        return self._statements[sql]

    def begin(self, *, is_durable: bool) -> None:
        """Begin a transaction that writes. One that is durable makes everything durable that was committed before it."""
        self._connection.run("BEGIN; SET LOCAL synchronous_commit TO on" if is_durable else "BEGIN")

    def prepare(self, layout: Layout | None, *, read_only: bool) -> None:
        """Make the tables unless they are there; refuse those of something else or of another version."""
        if layout is None:
            return
        if version := self._version(layout):
            return check_version(layout, version)
        if read_only:
            raise DatabaseError(f"there is no {layout.kind}")
        # One process makes the tables. The others wait before their transactions begin: within one, they need not see what it has made.
        self._connection.run("SELECT pg_advisory_lock(:key)", key=MAKING)
        self.begin(is_durable=True)
        if not self._version(layout):
            self._connection.run(f"CREATE SCHEMA IF NOT EXISTS {self._name}")
            self._connection.run("CREATE TABLE IF NOT EXISTS formats (kind TEXT PRIMARY KEY, version INTEGER NOT NULL)")
            for table in layout.tables:
                self._connection.run(table)
            self._connection.run("INSERT INTO formats VALUES (:kind, :version)", kind=layout.kind, version=layout.version)
        self._connection.run("COMMIT")
        self._connection.run("SELECT pg_advisory_unlock(:key)", key=MAKING)
        check_version(layout, self._version(layout))

    def _version(self, layout: Layout) -> int:
        """Return the version of these tables; 0 when there are none."""
        if not self._connection.run("SELECT to_regclass(:table) IS NOT NULL", table=f"{self._name}.formats")[0][0]:
            return 0
        rows = self._connection.run("SELECT version FROM formats WHERE kind = :kind", kind=layout.kind)
        return int(rows[0][0]) if rows else 0

    def wait(self, seconds: float, process: str) -> None:
        """Wait until something was announced in the database, or for so long; the name of the connection shows who does."""
        if not self._listens:
            self._connection.run(f"LISTEN {self._name}")
            self._connection.run("SELECT set_config('application_name', :name, false)", name=f"{self._waits}{process}"[:_NAME])
            self._listens = True
        if not self._connection.notifications:
            self._limit.begin(seconds)
            select.select([self._socket], [], [], seconds)
            self._connection.run("SELECT 1")  # which reads what has come
        self._connection.notifications.clear()

    def waiting(self) -> tuple[str, ...]:
        """Return the processes that wait: their connections are there, and have not been silent for long, as one that is cut off."""
        rows = self._connection.run(
            "SELECT DISTINCT substr(application_name, :begin) FROM pg_stat_activity"
            " WHERE datname = current_database() AND starts_with(application_name, :waits)"
            " AND coalesce(clock_timestamp() - state_change < make_interval(secs => :silent), true) ORDER BY 1",
            begin=len(self._waits) + 1,
            waits=self._waits,
            silent=_SILENT,
        )
        return tuple(str(process) for (process,) in rows or ())

    def announce(self) -> None:
        """Have those that wait go on."""
        self._connection.run(f"NOTIFY {self._name}")

    def close(self) -> None:
        """Close the connection."""
        with suppress(OSError, ValueError):
            self._socket.shutdown(socket.SHUT_RDWR)  # at once: a server that is cut off would not answer a farewell
        with suppress(Exception):
            self._connection.close()
        self._socket.close()


def _connected(url: ServerUrl, limit: OperationLimit) -> _Limited:
    """Return a connection to the server, which is encrypted as the ``sslmode`` says."""
    plain = socket.create_connection((url.host, url.port), LIMIT)
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # of Linux
        plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(LIMIT * 1000))
    mode = url.options.get("sslmode", "prefer")
    limited: socket.socket
    try:
        is_encrypted = mode != "disable" and _may_encrypt(plain)
        if not is_encrypted and mode not in ("disable", "prefer"):
            raise DatabaseError("the server refuses to encrypt the connection")
        if is_encrypted:
            context = ssl.create_default_context()
            if mode != "verify-full":
                context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            context.sslsocket_class = _LimitedSsl
            limited = context.wrap_socket(plain, server_hostname=url.host)
        else:
            limited = _Limited(plain.family, plain.type, plain.proto, plain.detach())
    except BaseException:
        plain.close()
        raise
    assert isinstance(limited, _Limited)
    limited.limit = limit
    return limited


def _may_encrypt(plain: socket.socket) -> bool:
    plain.sendall(_ASK_FOR_SSL)
    match plain.recv(1):
        case b"S" | b"N" as answer:
            return answer == b"S"
        case b"" | b"E":
            raise DatabaseError("the server refuses the connection")
    raise DatabaseError(_NONSENSE)
