"""The place of a database: an SQLite file, or tables in PostgreSQL."""

from __future__ import annotations

import getpass
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias
from urllib.parse import parse_qsl, unquote, urlsplit

from pnm.errors import InputError, suggestion

DEFAULT_NAME: Final = "pnm"
"""The schema of a database in which the tables are, unless another one is named: there may be several journals in a database."""
SSL_MODES: Final = ("prefer", "disable", "require", "verify-full")
_NAME: Final = re.compile(r"[a-z_][a-z0-9_]{0,62}")
_SCHEMES: Final = ("postgresql", "postgres")
_OPTIONS: Final = ("name", "sslmode")


@dataclass(frozen=True, slots=True)
class ServerUrl:
    """The place of tables in PostgreSQL; as text without the password.

    Args:
        options: ``name``, the schema of the tables; ``sslmode`` as PostgreSQL has it.
    """

    host: str
    port: int
    database: str
    user: str
    password: str | None = field(repr=False)
    options: Mapping[str, str]
    text: str = field(repr=False)
    """As it was given."""

    @classmethod
    def of(cls, text: str) -> ServerUrl:
        """Read ``postgresql://user:password@host:port/database?name=…``; raise `InputError` if it is something else."""
        try:
            parts = urlsplit(text)
            port, options = parts.port or 5432, dict(parse_qsl(parts.query, strict_parsing=bool(parts.query)))
        except ValueError as error:  # which may quote a part of the password
            expected = "postgresql://user:password@host:port/database, with %2F for / and the like in a password"
            raise InputError(f"{text.partition(':')[0]}://…: this is no URL of a database; expected {expected}") from error
        if parts.scheme not in _SCHEMES:
            raise InputError(f"there are no databases of {parts.scheme}://; expected a file, or postgresql://host/database")
        for option, value in options.items():
            if option not in _OPTIONS:
                raise InputError(f"postgresql://…: unknown option {option!r}; {suggestion(option, _OPTIONS) or 'expected name or sslmode'}")
            if option == "name" and not _NAME.fullmatch(value):
                raise InputError(f"postgresql://…: expected a name of lower-case letters, digits and _, found {value!r}")
            if option == "sslmode" and value not in SSL_MODES:
                raise InputError(f"postgresql://…: expected a sslmode of {', '.join(SSL_MODES)}, found {value!r}")
        database = unquote(parts.path.removeprefix("/"))
        if not (parts.hostname and database):
            raise InputError("postgresql://…: expected a host and a database, as in postgresql://host/database")
        user = unquote(parts.username or os.environ.get("PGUSER", "")) or getpass.getuser()
        password = unquote(parts.password) if parts.password else os.environ.get("PGPASSWORD")
        return cls(parts.hostname, port, database, user, password, options, text)

    @property
    def name(self) -> str:
        """The schema of the tables."""
        return self.options.get("name", DEFAULT_NAME)

    def __str__(self) -> str:
        return f"postgresql://{self.host}:{self.port}/{self.database}?name={self.name}"


_PASSWORD: Final = re.compile(r"(postgres(?:ql)?://[^\s:/?#@]*):.*@", re.IGNORECASE)


def without_password(text: str) -> str:
    """Return a text, such as an option with a URL, without the passwords of databases in it.

    >>> without_password("--journal=postgresql://ada:secret@host/db")
    '--journal=postgresql://ada@host/db'
    """
    return _PASSWORD.sub(r"\1@", text)


Place: TypeAlias = Path | ServerUrl
"""A file, or tables in PostgreSQL."""


def place_of(text: str) -> Place:
    """Return the place that a person has named; raise `InputError` if it is a URL of something else."""
    return ServerUrl.of(text) if "://" in text else Path(text).expanduser()
