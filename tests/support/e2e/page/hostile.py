"""Texts that attack who shows them, and journals, plans and nodes in which every text is one."""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from pnm.journal.kept import Row, TaskRow
from pnm.journal.store import JournalFile, KeptJournal

HOSTILE: Final = "\x1b[31mRED\x1b]0;OWNED\x07\x9b31m\x00\x7f\u202eltr\u2066[bold]x[/nope]:skull:{0}<img src=x onerror=pwn()>&\"'\\"
"""Escapes of terminals, with one byte as well; what XML has no letters for; turned letters; markup of rich, HTML and formats; quotes."""
_NAMES: Final = ("kitchen", "hall", "r1", "r2", "parcel1", "store", "move", "goal", "holds", "aborted", "door")
_KEPT: Final = ("@", "server", "parameters", "name", "hex")


def is_safe(text: str) -> bool:
    """Whether a text on lines controls nothing."""
    return all(letter.isprintable() or letter == "\n" for letter in text)


def hostile_journal(good: Path, evil: Path) -> Path:
    """Write a journal anew, with names and messages that attack."""
    with closing(KeptJournal(good)) as kept, closing(sqlite3.connect(good)) as tables:
        rows, firsts = list(kept.rows()), set(kept.segments())
        tasks = [TaskRow(*row) for row in tables.execute("SELECT task, wall, is_over, text FROM tasks")]
        parts = {key: _text(text) for key, text in tables.execute("SELECT key, text FROM parts")}
    written = [Row(row.time, _text(row.text), 0.0 if number in firsts else None) for number, row in rows]
    written += [written.pop()._replace(task=task._replace(is_over=bool(task.is_over), text=_text(task.text))) for task in tasks]
    with closing(JournalFile(evil, 0.0)) as file:
        file.append(written, parts)
    return evil


def _text(text: str) -> str:
    return json.dumps(_hostile(json.loads(text)))


def _hostile(value: Any, key: str = "") -> Any:
    match value:
        case str() if key not in _KEPT and not re.fullmatch("[0-9a-f]{8,}|[A-Z_]{3,}|/.*", value):
            found = next((name for name in _NAMES if re.search(rf"\b{name}\b", value)), None)
            return re.sub(rf"\b{found}\b", lambda name: name[0] + HOSTILE, value) if found else value
        case list():
            return [_hostile(entry, key) for entry in value]
        case dict():
            return {name: _hostile(entry, name) for name, entry in value.items()}
        case _:
            return value
