"""The journal of a node: where it is, unless the options of the node name another place, and how the node goes on with it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AsyncExitStack, suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from planner_bridge.node.node_log import NodeObserver, standing_words
from planner_bridge.node.options import Options
from planner_bridge.pipeline.loading import RATES, beside
from planner_bridge.tasks.result import TASKS
from pnm.clock import continue_from
from pnm.errors import InputError, PnmError, RosError
from pnm.files.database.place import Place, ServerUrl, place_of
from pnm.files.text import private_folder
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.journal.kept import DAY, Fenced, JournalChoice
from pnm.journal.lease import is_locked
from pnm.journal.replay import Replay
from pnm.journal.resume import stand_by, summaries
from pnm.knowledge.source import SourceError
from pnm.knowledge.sources import default_path
from pnm.tasks import EVENTS

_log = logging.getLogger(__name__)

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
    """Return a digest of the files of a node's world. Named goals are among them, because tasks have these names."""
    files = (options.domain, options.problem, options.world, options.goals)
    return sha256(b"\0".join(file.read_bytes() for file in files if file)).hexdigest()


def journal_of(chosen: str, node: str, domain_id: int, origin: str) -> Place | None:
    """Return where the journal of a node is, a file whose folder is made if there is none; None if nothing is to be kept.

    By default there is one for each node, by its name with its namespace and its ROS domain, and for what its world is made from:
    what the node has begun in another world does not go on in this one.

    Args:
        chosen: what the user has chosen; empty for nothing.
        node: its name, with its namespace.
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
                names = [task.accepted.wanted.words for task in summaries(other, TASKS) if task.ending is None]
                if names:
                    yield f"not finished with the files that this node had before: {', '.join(names)}; with them, they go on ({other})"


def latest_journal() -> Path:
    """Return the journal of the nodes of this user that was written last; raise an `InputError` if there is none."""
    folder = journals_folder()

    def written(journal: Path) -> float:
        log = journal.with_name(f"{journal.name}-wal")
        return max(file.stat().st_mtime for file in (journal, log) if file.exists())

    files = sorted(folder.glob(f"*{SUFFIX}"), key=written)
    if not files:
        raise InputError(f"there is no journal in {folder}; expected a file")
    return files[-1]


async def checked_names(ros: Any, plans: Iterable[str], place: Place | None) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """Return the actions of the node, and those of its plans, by plan; raise an error if another node has its name, or one of them.

    Who holds the journal has the names, and this node stands by for it. In a fleet there are others that stand by as well.
    """
    from pnm.ros.node.lifecycle import check_alone  # here, because rclpy is an extra
    from pnm.ros.tasks.task_node import action_names

    plan_actions: Mapping[str, str]
    task_actions, plan_actions = await ros.ask(partial(action_names, ros, plans))
    actions = (*task_actions, *plan_actions.values())
    if not isinstance(place, ServerUrl):
        try:
            await check_alone(ros, actions)
        except RosError:
            if place is None or not is_locked(place):
                raise
    return actions, plan_actions


async def resume(
    options: Options,
    place: Place | None,
    node: str,
    origin: str,
    observer: NodeObserver,
    fenced: Callable[[Fenced], None],
    stack: AsyncExitStack,
) -> tuple[Journal, Replay | None]:
    """Open the journal when no other process holds it; the time of what goes on in it goes on as well.

    Args:
        origin: a digest of what its world is made from.
        fenced: called when another node has taken the journal over.
    """
    observer.rated(options.rates or beside(options.domain, RATES))
    if place is None:
        observer.journalled("", None)
        return NO_JOURNAL, None
    if isinstance(place, Path) and not options.journal:
        for words in left_behind(place):
            _log.warning("%s", words)
    kept = options.keep_days * DAY
    choice = JournalChoice(place, options.durability, kept, lease=options.lease, node=node, adopts=options.adopt)

    def standing_by(holder: str) -> None:
        observer.standing_by(str(place), holder)
        EVENTS.info("%s", standing_words(str(place), holder))

    taken = await stand_by(choice, TASKS, origin, standing_by)
    journal, replay = taken.write(fenced), taken.replay
    stack.callback(journal.close)
    observer.journalled(str(place), len(replay.unfinished) if replay else None)
    if replay:
        continue_from(replay.now)
    return journal, replay
