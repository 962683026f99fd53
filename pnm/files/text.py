"""Texts of files, with clear refusals of what is missing, too large or not text."""

from __future__ import annotations

import codecs
import os
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from pnm.errors import InputError, Position, Tolerated

_ALIKE: Final = 0.8
"""The required likeness of a suggested file name; more than for other names, because endings are the same."""


def read_text(path: Path | str, limit: int) -> str:
    """Read a text file in UTF-8, of at most `limit` bytes; raise `InputError` for anything else."""
    raw = _read(path, limit)
    try:
        return _decoded(raw, path)
    except UnicodeDecodeError as error:
        message = f"not a text file: byte {raw[error.start]:#04x} is not UTF-8"
        raise InputError(message, _position(path, raw, error.start)) from error


def read_any_text(path: Path | str, limit: int) -> tuple[str, tuple[Tolerated, ...]]:
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


def _read(path: Path | str, limit: int) -> bytes:
    path, whole = Path(path), Position(str(path))
    try:
        if path.exists() and not path.is_file():
            raise InputError("this is a folder; expected a file" if path.is_dir() else "cannot be read: it is not a regular file", whole)
        with path.open("rb") as file:
            raw = file.read(limit + 1)
    except FileNotFoundError as error:
        near = nearest_file(path)
        raise InputError(f"there is no such file{f'; did you mean {str(near)!r}?' if near else ''}", whole) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", whole) from error
    if len(raw) > limit:
        raise InputError(f"the file has more than {limit} bytes; no more are read", whole)
    return raw


def nearest_file(path: Path) -> Path | None:
    """Return the file whose folders and name are nearest to those of this path; None if none is near."""
    here = Path(path.anchor)
    for part in path.relative_to(here).parts:
        if not (here / part).exists():
            try:
                near = get_close_matches(part, os.listdir(here), 1, _ALIKE)
            except OSError:
                return None
            if not near:
                return None
            part = near[0]
        here /= part
    return here if here.is_file() else None


def _decoded(raw: bytes, path: Path | str) -> str:
    if b"\0" in raw:
        raise InputError("not a text file: it contains zero bytes", Position(str(path), 1, 1))
    return raw.decode("utf-8-sig")


def _position(path: Path | str, raw: bytes, offset: int) -> Position:
    return Position(str(path), raw.count(b"\n", 0, offset) + 1, offset - raw.rfind(b"\n", 0, offset))
