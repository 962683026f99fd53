"""Files of domains and problems that others name: inside one folder, and never half written."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from planner_bridge.model import Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.reader import MAX_BYTES
from pnm.errors import InputError


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in the folder, whatever links are on the way.

    Raises:
        InputError: it is none, or is outside of the folder.
    """
    root = folder.resolve()
    if not name.strip() or "\0" in name:
        raise InputError(f"not a path: {name!r}; expected the path of a file in {root}")
    try:
        path = (root / name).resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(f"not a path: {name[:200]!r} ({error})") from error
    if root not in path.parents:
        raise InputError(f"{name[:200]!r} is not in the folder {root}; expected the path of a file in it")
    return path


def write_inside(folder: Path, name: str, text: str) -> Path:
    """Write a file in the folder, whole or not at all, and return its path.

    Raises:
        InputError: the path leads out of the folder, or cannot be written.
    """
    path = inside(folder, name)
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp")
        try:
            with open(handle, "w", encoding="utf-8") as file:
                file.write(text)
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


def load_texts(domain: str, problem: str, folder: Path, loaded: Domain) -> Problem:
    """Return a problem, of which domain and problem are each given as PDDL or as the path of a file in the folder.

    Args:
        domain: empty for the one that is loaded.
        problem: the problem.
        folder: what paths are relative to.
        loaded: the domain that is loaded.

    Raises:
        InputError: one of them cannot be read.
    """
    for text in (domain, problem):
        if len(text) > MAX_BYTES:
            raise InputError(f"{len(text)} characters; expected {MAX_BYTES} at most")
    chosen = loaded
    if domain.strip():
        chosen = parse_domain(domain, "domain") if _is_text(domain) else read_domain(inside(folder, domain))
    return parse_problem(problem, chosen, "problem") if _is_text(problem) else read_problem(inside(folder, problem), chosen)


def _is_text(given: str) -> bool:
    return given.lstrip()[:1] in ("(", ";")
