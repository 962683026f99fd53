"""Reading text files, with clear refusals of what is missing, too large or not text."""

from __future__ import annotations

import codecs
from pathlib import Path

from pnm.errors import InputError, Position, Tolerated


def read_text(path: Path, limit: int) -> str:
    """Read a text file in UTF-8, of at most `limit` bytes; raise `InputError` for anything else."""
    raw = _read(path, limit)
    try:
        return _decoded(raw, path)
    except UnicodeDecodeError as error:
        message = f"not a text file: byte {raw[error.start]:#04x} is not UTF-8"
        raise InputError(message, _position(path, raw, error.start)) from error


def read_any_text(path: Path, limit: int) -> tuple[str, tuple[Tolerated, ...]]:
    """Read a text file in UTF-8, in UTF-16 with its mark, or else in Latin-1; return a warning if it is not UTF-8."""
    raw = _read(path, limit)
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        start = Position(str(path), 1, 1)
        try:
            text = raw.decode("utf-16")
        except UnicodeDecodeError as error:
            raise InputError("not a text file: it begins as UTF-16 does and is none", start) from error
        if "\0" in text:
            raise InputError("not a text file: it contains zero characters", start)
        return text, (Tolerated("the file is in UTF-16; expected UTF-8", start),)
    try:
        return _decoded(raw, path), ()
    except UnicodeDecodeError as error:
        message = f"byte {raw[error.start]:#04x} is not UTF-8; the file is read as Latin-1"
        return raw.decode("latin-1"), (Tolerated(message, _position(path, raw, error.start)),)


def _read(path: Path, limit: int) -> bytes:
    start = Position(str(path), 1, 1)
    try:
        if not path.is_file() and path.exists():
            raise InputError("cannot be read: it is not a regular file", start)
        with path.open("rb") as file:
            raw = file.read(limit + 1)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", start) from error
    if len(raw) > limit:
        raise InputError(f"the file has more than {limit} bytes; no more are read", start)
    return raw


def _decoded(raw: bytes, path: Path) -> str:
    if b"\0" in raw:
        raise InputError("not a text file: it contains zero bytes", Position(str(path), 1, 1))
    return raw.decode("utf-8-sig")


def _position(path: Path, raw: bytes, offset: int) -> Position:
    return Position(str(path), raw.count(b"\n", 0, offset) + 1, offset - raw.rfind(b"\n", 0, offset))
