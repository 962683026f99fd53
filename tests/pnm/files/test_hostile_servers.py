"""Servers that do not speak PostgreSQL's protocol: each is told in words."""

from __future__ import annotations

import re
import socket
import struct
import threading

import pytest
from hypothesis import given, strategies as st

from pnm.files.database.database import Database
from pnm.files.database.driver import DatabaseError, Layout
from pnm.files.database.place import place_of
from tests.support.e2e.hosts.hostile_postgres import in_time, serving

LAYOUT = Layout("notebook", 0x504E4D54, 1, ("CREATE TABLE notes (id INTEGER PRIMARY KEY, text TEXT NOT NULL)",))


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
