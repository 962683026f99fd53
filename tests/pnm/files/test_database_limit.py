"""Operations on databases have an end: files whose queries have none, servers whose answers have none or make no sense, and signals."""

from __future__ import annotations

import re
import shutil
import signal
import socket
import sqlite3
import ssl
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from pnm.files.database import driver
from pnm.files.database.database import Database
from pnm.files.database.driver import DatabaseError, Layout
from pnm.files.database.place import place_of
from tests.support.e2e.hosts.hostile_postgres import in_time, serving
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import LIMIT, Program

LAYOUT = Layout("notebook", 0x504E4D54, 1, ("CREATE TABLE notes (id INTEGER PRIMARY KEY, text TEXT NOT NULL)",))
ENDLESS = "WITH RECURSIVE endless(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM endless) SELECT {} FROM endless"


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have operations end early."""
    monkeypatch.setattr(driver, "SECONDS", 1.5)
    monkeypatch.setattr(driver, "SIZE", 1_000_000)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A file with the tables."""
    with closing(Database(tmp_path / "notes.sqlite", LAYOUT)):
        return tmp_path / "notes.sqlite"


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize(
    ("what", "said"),
    [("count(*)", r"it has not answered within 1\.5 s"), ("x", "it answers with more than"), ("'{}'", "it answers with more than")],
)
def test_a_query_that_does_not_end_is_ended_and_the_file_is_read_on(file: Path, what: str, said: str) -> None:
    with closing(Database(file, LAYOUT, read_only=True)) as database:
        with pytest.raises(DatabaseError, match=said):
            in_time(lambda: database.run(ENDLESS.format(what)))
        assert database.run("SELECT 1") == [(1,)]


@pytest.mark.parametrize(
    "statement",
    [
        f"CREATE VIEW more AS {ENDLESS.format('x')}",
        "CREATE TRIGGER more AFTER INSERT ON notes BEGIN DELETE FROM notes; END",
        "CREATE VIRTUAL TABLE more USING fts5(text)",
    ],
    ids=["a view", "a trigger", "a virtual table"],
)
def test_a_file_with_more_than_tables_is_refused(file: Path, statement: str) -> None:
    with closing(sqlite3.connect(file)) as connection:
        connection.execute(statement)
        connection.commit()
    for read_only in (True, False):
        with pytest.raises(DatabaseError, match="it has more than the tables of a notebook"):
            Database(file, LAYOUT, read_only=read_only)


INTERRUPTED = """
import sys
from pathlib import Path
from tests.pnm.files.test_database_limit import ENDLESS, LAYOUT, Database

database = Database(Path(sys.argv[1]), LAYOUT)
try:
    print("begun", flush=True)
    database.run(ENDLESS.format("count(*)"))
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def test_ctrl_c_ends_a_query(file: Path) -> None:
    program = Program(["-c", INTERRUPTED, str(file)], {})
    try:
        program.until(lambda: "begun" in program.out)
        program.process.send_signal(signal.SIGINT)
        assert program.ended(driver.SECONDS / 2) == 0
        assert program.out == ["begun", "interrupted"]
    finally:
        program.close()


# --- PostgreSQL ---


def trickle(client: socket.socket) -> None:
    over = threading.Event()
    for byte in b"S" * 1000:
        client.sendall(bytes([byte]))
        over.wait(0.1)  # as slow as a server is that is never silent for long


def flood(client: socket.socket) -> None:
    message = b"Mnotice\0\0"
    while True:
        client.sendall((b"N" + struct.pack("!I", 4 + len(message)) + message) * 1000)


def swell(client: socket.socket) -> None:
    client.sendall(b"N" + struct.pack("!I", 100_000_000))
    while True:
        client.sendall(b"x" * 100_000)


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize(
    ("answer", "said"),
    [(trickle, r"it has not answered within 1\.5 s"), (flood, "it answers with more than"), (swell, "it answers with more than")],
)
def test_a_server_whose_answers_do_not_end_is_not_heard_to_the_end(answer: Callable[[socket.socket], None], said: str) -> None:
    with serving(answer) as url, pytest.raises(DatabaseError, match=said):
        in_time(lambda: Database(place_of(url), LAYOUT))


def test_an_answer_for_which_there_is_no_memory_is_an_error_in_words(file: Path) -> None:
    with closing(Database(file, LAYOUT)) as database, pytest.raises(DatabaseError, match="more than there is memory for"):
        database.do(lambda _: bytes(1 << 62))


@pytest.mark.usefixtures("hurry")
def test_a_result_of_postgresql_has_its_limit_and_the_connection_is_opened_anew(postgres: PostgresServer) -> None:
    with closing(Database(place_of(postgres.database()), LAYOUT)) as database:
        with pytest.raises(DatabaseError, match="it answers with more than"):
            in_time(lambda: database.run("SELECT repeat('x', 1000) FROM generate_series(1, 100000)"))
        assert not database.is_connected
        assert database.run("SELECT 1") == [[1]]


@pytest.fixture
def encrypting(postgres: PostgresServer, tmp_path: Path) -> Iterator[int]:
    """The port of what encrypts connections to PostgreSQL, as a server with a certificate of its own does."""
    if not (openssl := shutil.which("openssl")):
        pytest.skip("openssl makes the certificate")
    certificate = tmp_path / "certificate.pem"
    made = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=pnm", "-keyout", str(certificate), "-out", str(tmp_path / "c")]
    subprocess.run([openssl, *made], check=True, capture_output=True)
    certificate.write_text(certificate.read_text() + (tmp_path / "c").read_text())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)

    def pump(source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def serve() -> None:
        while True:
            try:
                plain, _ = listening.accept()
            except OSError:
                return
            with suppress(OSError):  # who does not trust the certificate goes away
                plain.recv(8)
                plain.sendall(b"S")
                client = context.wrap_socket(plain, server_side=True)
                server = socket.create_connection(("127.0.0.1", postgres.port), LIMIT)
                for pair in ((client, server), (server, client)):
                    threading.Thread(target=pump, args=pair, daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=serve, daemon=True).start()
        yield int(listening.getsockname()[1])


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("mode", ["prefer", "require"])
def test_an_encrypted_connection_has_the_same_limit(postgres: PostgresServer, encrypting: int, mode: str) -> None:
    url = f"{postgres.database().replace(str(postgres.port), str(encrypting))}?sslmode={mode}"
    with closing(Database(place_of(url), LAYOUT)) as database:
        assert database.run("SELECT 1") == [[1]]
        with pytest.raises(DatabaseError, match="it answers with more than"):
            in_time(lambda: database.run("SELECT repeat('x', 1000) FROM generate_series(1, 100000)"))


def test_encryption_that_is_required_is_not_left_out(postgres: PostgresServer, encrypting: int) -> None:
    with pytest.raises(DatabaseError, match="the server refuses to encrypt the connection"):
        Database(place_of(f"{postgres.database()}?sslmode=require"), LAYOUT)
    with pytest.raises(DatabaseError, match="certificate"):
        Database(place_of(f"postgresql://pnm@127.0.0.1:{encrypting}/postgres?sslmode=verify-full"), LAYOUT)


# --- servers that do not speak its protocol: each is told in words ---


def refuse(client: socket.socket, words: bytes) -> None:
    message = b"SFATAL\0M" + words + b"\0\0"
    client.sendall(b"E" + struct.pack("!I", 4 + len(message)) + message)


def shout(client: socket.socket) -> None:
    refuse(client, b"no! " * 10_000)


def test_a_server_has_its_words_but_not_without_end() -> None:
    with serving(shout) as url, pytest.raises(DatabaseError, match=r"^(no! ){10,250}$"):
        in_time(lambda: Database(place_of(url), LAYOUT))


KINDS = b"RSKZTEDC123n tNAGHWscd"
"""The first bytes of messages, of a server and of something else."""
CLEAR = (
    r"not speak PostgreSQL's protocol|network error|timed out|Connection reset|Broken pipe|answers with more|Authentication method|password"
)
messages = st.lists(st.tuples(st.sampled_from(KINDS), st.binary(max_size=40), st.sampled_from([0, 0, 0, -5, 1, 1 << 30])), max_size=4)


@given(messages, st.booleans())
def test_whatever_a_server_answers_is_an_error_in_words(answers: list[tuple[int, bytes, int]], is_raw: bool) -> None:
    def answer(client: socket.socket) -> None:
        for kind, data, wrong in answers:
            client.sendall(data if is_raw else bytes([kind]) + struct.pack("!i", 4 + len(data) + wrong) + data)

    with serving(answer) as url, pytest.raises(DatabaseError) as caught:
        in_time(lambda: Database(place_of(url), LAYOUT))
    has_words = any(kind in b"E" for kind, _, _ in answers)
    assert has_words or re.search(CLEAR, str(caught.value))


@pytest.mark.parametrize(
    ("first", "said"),
    [(b"HTTP/1.1 400 Bad Request", "the server does not speak PostgreSQL's protocol"), (b"", "the server refuses the connection")],
)
def test_something_else_that_listens_is_named(first: bytes, said: str) -> None:
    def answer() -> None:
        client, _ = listening.accept()
        with client:
            client.recv(8)
            client.sendall(first)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=answer, daemon=True).start()
        with pytest.raises(DatabaseError, match=said):
            in_time(lambda: Database(place_of(f"postgresql://pnm@127.0.0.1:{listening.getsockname()[1]}/db"), LAYOUT))


def ask_for_a_password(client: socket.socket) -> None:
    client.sendall(b"R" + struct.pack("!II", 23, 10) + b"SCRAM-SHA-256\0\0")
    client.recv(4096)
    refuse(client, b"password authentication failed")


def test_without_a_password_the_server_says_that_it_is_wrong() -> None:
    with serving(ask_for_a_password) as url, pytest.raises(DatabaseError, match="password authentication failed"):
        in_time(lambda: Database(place_of(url), LAYOUT))
