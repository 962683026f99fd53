"""Text files: read with their limits, and written for their owner alone."""

from __future__ import annotations

import codecs
import os
from collections.abc import Callable
from contextlib import suppress
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


_SECRET: Final = "secret"


def private_folder(path: Path) -> None:
    """Make a folder, and those above it that are not there."""
    for folder in (*reversed(path.absolute().parents), path.absolute()):
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
    path.mkdir(exist_ok=True)  # which says what is wrong if it is no folder


def private_file(path: Path) -> None:
    """Make an empty file unless there is one."""
    os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))


def write_private(path: Path, text: str) -> None:
    """Replace a file, whatever it was."""
    private_folder(path.parent)
    replace_file(path, text, 0o600)


def replace_file(path: Path, text: str, mode: int) -> None:
    """Replace a file at once: there is the old text or the new one, whatever ends before."""
    draft = path.with_name(f".{os.urandom(8).hex()}.tmp")
    try:
        with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600), "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
            os.fchmod(file.fileno(), mode)
        draft.replace(path)
    except BaseException:
        with suppress(OSError):
            draft.unlink()
        raise


def secret_in(folder: Path) -> bytes:
    """Return the secret of a folder, which is made when it is first asked for; raise an `OSError` if there can be none."""
    path = folder / _SECRET
    if not path.exists():
        write_private(path, os.urandom(32).hex())
    return path.read_bytes()


def hide_arguments(shown: Callable[[str], str]) -> None:
    """Have the list of processes show the arguments of this one as a function returns them, at most as long, where the system lets us."""
    with suppress(OSError, ValueError, IndexError):
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        start, end = int(fields[45]), int(fields[46])  # see `arg_start` in proc(5)
        with open("/proc/self/mem", "r+b", buffering=0) as memory:
            memory.seek(start)
            given = memory.read(end - start)
            text = "\0".join(map(shown, given.decode(errors="surrogateescape").split("\0"))).encode(errors="surrogateescape")
            if text != given:
                memory.seek(start)
                memory.write(text[: len(given)].ljust(len(given), b"\0"))
