"""The folder whose PDDL files the clients of a node load, and to which they save: nothing else can be named, or overwritten."""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from planner_bridge.pddl.read.reader import MAX_BYTES
from pnm.errors import InputError
from pnm.files.text import read_any_text

SUFFIX: Final = ".pddl"
_PROBLEM: Final = re.compile(r"(?:\s|;[^\n]*(?:\n|\Z))*+\(\s*define\s*\(\s*problem\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ProblemFolder:
    """The folder for problems of a node.

    Args:
        root: None if the node has no such folder.
        initial: the file of the problem with which the node begins, which is never overwritten.

    Raises:
        InputError: there is no such folder.
    """

    root: Path | None
    initial: Path | None = None

    def __post_init__(self) -> None:
        if self.root is not None and not os.path.isdir(self.root):
            raise InputError(f"there is no folder {str(self.root)!r} for problems; expected one that exists in the parameter 'problems'")

    def path_of(self, name: str) -> Path:
        """Return the path of a PDDL file in the folder, symbolic links resolved; raise an `InputError` for any other."""
        if self.root is None:
            raise InputError("the node has no folder for problems; expected one in its parameter 'problems' when it starts")
        root = self.root.resolve()
        if not name.strip() or "\0" in name:
            raise InputError(f"not a path: {name!r}; expected the path of a file in {root}")
        try:
            path = (root / name).resolve()
        except (OSError, RuntimeError) as error:
            raise InputError(f"not a path: {name[:200]!r} ({error})") from error
        if root not in path.parents:
            raise InputError(f"{name[:200]!r} is not in the folder {root}; expected the path of a file in it")
        if path.suffix != SUFFIX or any(part.startswith(".") for part in path.relative_to(root).parts):
            raise InputError(f"{name[:200]!r} is not the name of a PDDL file; expected one that ends with {SUFFIX}, and no hidden one")
        return path

    def write(self, name: str, problem: str) -> Path:
        """Write the text of a problem to a file atomically, and return its path.

        Raises:
            InputError: the file is outside of the folder, would overwrite something that is not a problem, or cannot be written.
        """
        path = self.path_of(name)
        try:
            if self.initial is not None and path.exists() and self.initial.exists() and path.samefile(self.initial):
                raise InputError(f"{path}: cannot be written: the node begins with this problem; expected another name")
            if path.exists() and _PROBLEM.match(read_any_text(path, MAX_BYTES)[0]) is None:
                raise InputError(f"{path}: cannot be written: what is there is not a problem in PDDL; expected another name")
            handle, draft = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp")
            try:
                with open(handle, "w", encoding="utf-8") as file:
                    file.write(problem)
                    file.flush()
                    os.fsync(file.fileno())
                os.chmod(draft, 0o644)
                os.replace(draft, path)
            except BaseException:
                with suppress(OSError):
                    os.unlink(draft)
                raise
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        return path
