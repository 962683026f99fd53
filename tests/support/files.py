"""Where the project's files are, files that tests write, and files of bad input.

Bad input lies in folders called `refused` beside the tests, with the expected message beneath each case. A case is a text and then
a line with the mark and the message; a blank line stands between two cases:

    (:action a :efect (idle))
    ;! 2:12: unknown key ':efect' in the action 'a'; did you mean ':effect'?

Lines that begin with three characters of comment (``;;;`` or ``###``) are for the reader of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from pnm.errors import InputError

ROOT: Final = Path(__file__).parents[2]
SHARED: Final = ROOT.parent / "shared"
"""Problems and plans beside the project, on machines that have them."""


def written(path: Path, content: str | bytes) -> Path:
    """Write a file and return its path; in a folder, it is called plan.yaml."""
    file = path / "plan.yaml" if path.is_dir() else path
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return file


def input_error(read: Callable[[], object]) -> InputError | None:
    """Return why an input is refused, or None if it is read; any other exception passes."""
    try:
        read()
    except InputError as error:
        return error
    return None


MARKS = {".pddl": (";! ", ";;;"), ".yaml": ("#! ", "###")}


def refused(*files: Path) -> list[Any]:
    """Return the cases of files as parameters: text and message."""
    import pytest  # here, because a newcomer who follows the tutorial runs its robot without the tests' packages

    return [pytest.param(text, message, id=f"{file.stem}: {message}") for file in files for text, message in cases(file)]


def refused_by_file(folder: Path) -> list[Any]:
    """Return the cases of all files of a folder as parameters: name of the file, text and message."""
    import pytest

    files = sorted(file for file in folder.iterdir() if file.suffix in MARKS)
    return [pytest.param(file.stem, text, message, id=f"{file.stem}: {message}") for file in files for text, message in cases(file)]


def cases(file: Path) -> Iterator[tuple[str, str]]:
    """Read the texts and messages of a file."""
    mark, remark = MARKS[file.suffix]
    lines: list[str] = []
    for line in file.read_text(encoding="utf-8").split("\n"):
        if line.startswith(mark):
            yield "\n".join(lines), line.removeprefix(mark)
            lines = []
        elif not line.startswith(remark) and (lines or line):
            lines.append(line)
    assert not any(lines), f"{file} ends without a message"
