"""Where journals are: that of a node, unless its options name another."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from planner_bridge.node.options import Options
from planner_bridge.tasks.result import TASKS
from pnm.errors import InputError, PnmError
from pnm.files.database.place import Place, place_of
from pnm.files.private import private_folder
from pnm.journal.resume import summaries
from pnm.knowledge.database import default_path
from pnm.knowledge.source import SourceError

NONE: Final = "none"
"""In place of a file: nothing is kept."""
SUFFIX: Final = ".journal"


def journals_folder() -> Path:
    """Return the folder of the journals of nodes; raise an `InputError` if the user has no home."""
    try:
        return default_path().parent / "journals"
    except SourceError as error:
        raise InputError(f"there is no place for the journal: {error}, or `--journal {NONE}`") from error


def origin_of(options: Options) -> str:
    """Return what the world of a node is made from: a digest of its files. Goals with names are among them, for tasks have these names."""
    files = (options.domain, options.problem, options.world, options.goals)
    return sha256(b"\0".join(file.read_bytes() for file in files if file)).hexdigest()


def journal_of(chosen: str, node: str, domain_id: int, origin: str) -> Place | None:
    """Return where the journal of a node is, a file whose folder is made if there is none; None if nothing is to be kept.

    By default there is one for each node, by its name with its namespace and its ROS domain, and for what its world is made from:
    what the node has begun in another world does not go on in this one.

    Args:
        chosen: what the user has chosen; empty for nothing.
        node: its name, with its namespace.
        domain_id: of ROS.
        origin: a digest of what its world is made from.
    """
    if chosen:
        return None if chosen == NONE else place_of(chosen)
    folder, name = journals_folder(), node.strip("/").replace("/", ".")
    try:
        private_folder(folder)
    except OSError as error:
        advice = f"--journal FILE names another place, --journal {NONE} keeps nothing"
        raise InputError(f"there is no place for the journal: {folder} cannot be made: {error.strerror}; {advice}") from error
    return folder / f"{name}-{domain_id}-{origin[:12]}{SUFFIX}"


def left_behind(place: Path) -> Iterator[str]:
    """Yield in words which other journals that the same node has by default have unfinished tasks: it had other files then."""
    for other in sorted(place.parent.glob(f"{place.name.rpartition('-')[0]}-*{SUFFIX}")):
        if other != place:
            with suppress(PnmError):  # of another version, or no journal
                names = [task.accepted.wanted.text or "the goal of the problem" for task in summaries(other, TASKS) if task.ending is None]
                if names:
                    yield f"not finished with the files that this node had before: {', '.join(names)}; with them, they go on ({other})"


def latest_journal() -> Path:
    """Return the journal of the nodes of this user that was written last; raise an `InputError` if there is none."""
    folder = journals_folder()
    files = sorted(folder.glob(f"*{SUFFIX}"), key=_written)
    if not files:
        raise InputError(f"there is no journal in {folder}; expected a file")
    return files[-1]


def _written(journal: Path) -> float:
    log = journal.with_name(f"{journal.name}-wal")
    return max(file.stat().st_mtime for file in (journal, log) if file.exists())
