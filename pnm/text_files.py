"""Reading text files, with clear refusals of what is missing, too large or not text."""

from __future__ import annotations

from pathlib import Path

from pnm.errors import InputError, Position


def read_text(path: Path, limit: int) -> str:
    """Read a text file, with clear refusals of what is missing, too large or not text."""
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
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise InputError(f"not a text file: byte {raw[error.start]:#04x} is not UTF-8", Position(str(path), line, column)) from error
    if "\0" in text:
        raise InputError("not a text file: it contains zero bytes", start)
    return text
