"""Private files of this user, with mode 0600 in folders with 0700, one of them with a secret; and arguments of this process."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

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
    draft = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600), "w", encoding="utf-8") as file:
        file.write(text)
    draft.replace(path)


def secret_in(folder: Path) -> bytes:
    """Return the secret of a folder, which is made when it is first asked for; raise an `OSError` if there can be none."""
    path = folder / _SECRET
    if not path.exists():
        write_private(path, secrets.token_hex(32))
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
