"""The sources of answers that a run does not have itself: the knowledge all runs share, and people.

`Sources` sends every question to the right one; `open_sources` makes it from the names that a file chose, which
`register_source` adds to. None of the sources ever blocks the event loop, and every wait has a limit.

A package registers a source with an entry point in the group ``pnm.knowledge.sources``, or ``pnm.people`` if the source
stands for a person; a program with `register_source`.
"""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from time import time
from typing import Any, Final, TypeAlias, TypeVar
from uuid import UUID

from pnm.core.execution.questions import LIMITS
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.errors import InputError, PnmError, Position, suggestion
from pnm.files.database.database import Database
from pnm.files.database.driver import DatabaseError, Layout, SqlQuery
from pnm.files.database.place import Place, ServerUrl
from pnm.files.text import private_folder
from pnm.knowledge.people import ANSWER_LIMIT, ScriptedAnswers, TerminalSource, is_for_people, is_terminal, question_words, read_answer
from pnm.knowledge.source import Asker, MemoryKnowledge, Source, SourceError, read_value, write_value

GRACE: Final = 1.0
"""Seconds more for sources with a time limit of their own, whose error message is more precise."""
LIMIT: Final = 5.0
"""Time limit of a knowledge base, in seconds."""
PERSON_LIMIT: Final = ANSWER_LIMIT + GRACE
"""Time limit of a person, in seconds."""
T = TypeVar("T")
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class OpenQuestion:
    """A question that people are asked, and on whose behalf; in words with the answers to choose from."""

    question: Question
    asker: Asker

    def __str__(self) -> str:
        return question_words(self.question)


class Sources:
    """The global knowledge in one or more knowledge bases, and a person; itself a `Source`.

    A query goes through the knowledge bases in order until one has a value other than null; an update goes to the first, where every
    later query finds it. Questions for people (`is_for_people`) go to the person. A knowledge base that fails is an error and
    never skipped: the next one might have another value. The limits are in seconds, for each knowledge base and for the person.

    The mutable state is the questions that people are asked, by their ids: answers may come by other ways as well (`answer`); and who
    hears of each that opens or closes (`listeners`).
    """

    def __init__(
        self, shared: Sequence[Source] = (), person: Source | None = None, *, limit: float = LIMIT, person_limit: float = PERSON_LIMIT
    ) -> None:
        self._shared = tuple(shared)
        self._person = person
        self._limit = limit
        self._person_limit = person_limit
        self._open: dict[UUID, tuple[OpenQuestion, asyncio.Future[object]]] = {}
        self.listeners: list[Callable[[], None]] = []

    def __repr__(self) -> str:
        return f"<Sources {', '.join(map(repr, self._shared)) or 'no knowledge base'}; {self._person or 'nobody'!r}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the first value in any of the knowledge bases, or the person's answer; or `MISSING`."""
        if is_for_people(question):
            asked = self._ask(self._person_for(question), question, asker)
            return await self._within(self._person_limit, asked, f"nobody has answered {question}")
        for source in self._shared:
            value = await self._within(self._limit, source.query(question, asker), f"{source!r} has not answered {question}")
            if value is not MISSING and value is not None:
                return value
        return MISSING

    @property
    def open_questions(self) -> tuple[OpenQuestion, ...]:
        """The questions that people are asked now, the oldest first."""
        return tuple(question for question, _ in self._open.values())

    def answer(self, question: UUID, text: str) -> bool:
        """Take a person's answer from elsewhere; return whether the question is open. Raise `SourceError` if the text is no answer."""
        asked, waiting = self._open.get(question, (None, None))
        if asked is None or waiting is None or waiting.done():
            return False
        waiting.set_result(read_answer(text, asked.question))
        return True

    async def _ask(self, person: Source, question: Question, asker: Asker) -> object:
        """Ask a person, and return what is answered first, by whichever way."""
        if asker.question is None:
            return await person.query(question, asker)
        asking = asyncio.ensure_future(person.query(question, asker))
        answered: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        self._open[asker.question] = (OpenQuestion(question, asker), answered)
        self._tell()
        try:
            await asyncio.wait((asking, answered), return_when=asyncio.FIRST_COMPLETED)
            return answered.result() if answered.done() else await asking
        finally:
            del self._open[asker.question]
            self._tell()
            asking.add_done_callback(lambda asked: asked.cancelled() or asked.exception())  # nobody else looks at what went wrong
            if not asking.done():
                asking.cancel()
                await asyncio.wait((asking,), timeout=self._limit)  # it is withdrawn where it is shown

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value in the first knowledge base, or show it to the person."""
        if is_for_people(question):
            person = self._person_for(question)
            await self._within(self._person_limit, person.update(question, value, asker), f"nobody has heard {question}")
        elif self._shared:
            first = self._shared[0]
            await self._within(self._limit, first.update(question, value, asker), f"{first!r} has not stored {question}")
        else:
            raise SourceError(f"there is no knowledge base to store {question} in")

    async def close(self) -> None:
        """Close all of them; one that fails is logged."""
        sources = [*self._shared, *([self._person] if self._person is not None else [])]
        closing = [self._within(self._limit, source.close(), "not closed") for source in sources]
        errors = await asyncio.gather(*closing, return_exceptions=True)
        for source, error in zip(sources, errors, strict=True):
            if isinstance(error, Exception):
                _log.warning("%r cannot be closed: %s", source, error)

    def _tell(self) -> None:
        for listener in self.listeners:
            listener()

    def _person_for(self, question: Question) -> Source:
        if self._person is None:
            raise SourceError(f"nobody can be asked or told {question}")
        return self._person

    async def _within(self, limit: float, answer: Awaitable[T], otherwise: str) -> T:
        timer = asyncio.timeout(limit)
        try:
            async with timer:
                return await answer
        except TimeoutError as error:  # by the timer, or by the source itself
            how = f" within {limit:g} s" if timer.expired() else f": {str(error) or type(error).__name__}"
            raise SourceError(f"{otherwise}{how}") from error
        except SourceError:
            raise
        except PnmError as error:
            raise SourceError(f"{otherwise}: {error}") from error


# --- the registry --------------------------------------------------------------------------

GROUPS: Final = {"pnm.knowledge.sources": Layer.GLOBAL, "pnm.people": Layer.PERSON}
"""The groups of entry points, and the layer of the sources in them."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The process that sources are made in."""

    ros: Any = None
    """The `pnm.ros.node.ros_thread.RosThread` of this process; None when it has none."""
    folder: Path = field(default_factory=Path)
    """The folder that paths in the options are relative to."""
    answers: tuple[tuple[str, object], ...] = ()
    """Names and values: what people would answer, so that they are not asked."""


Factory: TypeAlias = Callable[[Mapping[str, object], Surroundings], Source]
"""Makes a source, given its options; raises `InputError` or `SourceError`. The option ``limit`` is its time limit in seconds."""


@dataclass(frozen=True, slots=True)
class SourceChoice:
    """A source chosen in a file, with its options."""

    name: str
    options: Mapping[str, object] = field(default_factory=dict)
    position: Position | None = None


@dataclass(frozen=True, slots=True)
class _Registered:
    load: Callable[[], Factory]
    layer: Layer


_OWN: Final = {
    "sqlite": ("pnm.knowledge.sources:sqlite", Layer.GLOBAL),
    "postgres": ("pnm.knowledge.sources:postgres", Layer.GLOBAL),
    "memory": ("pnm.knowledge.sources:memory", Layer.GLOBAL),
    "ros2": ("pnm.ros.knowledge:ros2", Layer.GLOBAL),
    "person": ("pnm.knowledge.sources:person", Layer.PERSON),
    "terminal": ("pnm.knowledge.sources:terminal", Layer.PERSON),
    "topics": ("pnm.ros.knowledge:topics", Layer.PERSON),
}
"""The built-in sources, loaded like those of other packages, so that nothing here imports ROS 2."""
_DEFAULTS: Final = {Layer.GLOBAL: SourceChoice("sqlite"), Layer.PERSON: SourceChoice("person")}
"""The sources used when none is chosen."""
_ORIGINAL: Final = dict.fromkeys(("RPKnowledgeBase", "ROSExternalKnowledgeBase", "ExternalKnowledgeBase"), _DEFAULTS[Layer.GLOBAL].name)
"""Classes named in files for the original implementation, with the sources used in their place."""
_registered: Final[dict[str, _Registered]] = {}


def register_source(name: str, factory: Factory, *, layer: Layer = Layer.GLOBAL) -> None:
    """Register a source that files can choose; one of the same name is replaced.

    The name is such as ``ontology``, or the ``module.class`` that a file for the original implementation has. The factory makes it, given
    its options and `Surroundings`; a class that takes these will do. The layer is `Layer.PERSON` if it stands for a person.
    """
    _registered[name] = _Registered(lambda: factory, layer)


def check_source(name: str, position: Position | None = None) -> str:
    """Return the registered name for a name in a file: itself, or the last part of ``module.class``; raise `InputError` for others."""
    known = _all()
    for candidate in (name, name.rpartition(".")[2]):
        if candidate in known:
            return candidate
    names = sorted(known)
    near = suggestion(name, names) or suggestion(name.rpartition(".")[2], names)
    hint = near or f"expected one of {', '.join(name for name in names if name not in _ORIGINAL)}"
    call = f"pnm.knowledge.sources.register_source({name!r}, factory)"
    how = f"to add one, call {call}, or have a package declare an entry point in {next(iter(GROUPS))}"
    raise InputError(f"there is no source of knowledge {name!r}; {hint}; {how}", position)


def open_sources(choices: Sequence[SourceChoice], surroundings: Surroundings, place: Place | None = None) -> Sources:
    """Make the chosen sources, and the default ones where none was chosen: the knowledge file of this user, and a person.

    Nothing is opened or asked yet: a source that cannot be used fails when it is needed. `place` has the
    global knowledge, in place of any chosen source. Raises `InputError` if a name or an option is wrong, or there are two
    sources for people, `SourceError` if a source cannot be made here.
    """
    chosen: dict[Layer, list[SourceChoice]] = {layer: [] for layer in _DEFAULTS}
    for choice in choices:
        layer = _all()[check_source(choice.name, choice.position)].layer
        if layer is Layer.PERSON and chosen[layer]:
            raise InputError(f"{choice.name} speaks for people, and so does another source; expected one of them", choice.position)
        if layer is Layer.PERSON or place is None:
            chosen[layer].append(choice)
    shared, people = (chosen[layer] or [default] for layer, default in _DEFAULTS.items())
    asked = make_source(people[0], surroundings)
    return Sources(
        [DatabaseKnowledge(place)] if place else [make_source(choice, surroundings) for choice in shared],
        ScriptedAnswers(surroundings.answers, asked) if surroundings.answers else asked,
        limit=_limit_of(shared, LIMIT, LIMITS[Layer.GLOBAL]),
        person_limit=_limit_of(people, PERSON_LIMIT, LIMITS[Layer.PERSON]),
    )


def _limit_of(choices: Sequence[SourceChoice], default: float, most: float) -> float:
    """Return the time limit in seconds for any of them; a source with a ``limit`` of its own keeps that itself, hence the grace."""
    limits = [default]
    for choice in choices:
        own = choice.options.get("limit")
        if isinstance(own, int | float):
            limits.append(own + GRACE)
            if limits[-1] > most:
                raise InputError(f"{choice.name}: expected a limit of at most {most - GRACE:g} seconds, found {own}", choice.position)
    return max(limits)


def make_source(choice: SourceChoice, surroundings: Surroundings) -> Source:
    """Make one source; raise `InputError` if its name or an option is wrong, `SourceError` if it cannot be made here."""
    try:
        return _all()[check_source(choice.name, choice.position)].load()(choice.options, surroundings)
    except InputError as error:
        raise error if error.position else InputError(f"{choice.name}: {error.message}", choice.position) from error
    except (ImportError, AttributeError) as error:
        raise InputError(f"the source {choice.name!r} is registered but cannot be loaded: {error}", choice.position) from error


def _all() -> dict[str, _Registered]:
    """Return all registered sources by name; those of programs go before those of packages, and these before the built-in ones."""
    from importlib.metadata import EntryPoint  # here and below, because whoever only reads a journal looks for no source

    own = {name: _Registered(EntryPoint(name, value, "").load, layer) for name, (value, layer) in _OWN.items()}
    original = {name: own[ours] for name, ours in _ORIGINAL.items()}
    return {**original, **own, **_of_packages(*sys.path), **_registered}


@cache
def _of_packages(*places: str) -> Mapping[str, _Registered]:
    """Return the sources that the packages in these places register; all packages are read for that."""
    from importlib.metadata import entry_points

    found = entry_points()
    return {entry.name: _Registered(entry.load, layer) for group, layer in GROUPS.items() for entry in found.select(group=group)}


def memory(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``memory``: knowledge that lasts as long as the process. It has no options."""
    only(options)
    return MemoryKnowledge()


def sqlite(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``sqlite``: knowledge in a ``file``, by default the user's own."""
    only(options, "file")
    file = text(options, "file", "")
    return DatabaseKnowledge(surroundings.folder / Path(file).expanduser() if file else None)


def postgres(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``postgres``: knowledge in the database of a ``url``, which hosts share."""
    only(options, "url")
    return DatabaseKnowledge(ServerUrl.of(text(options, "url", "")))


def terminal(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``terminal``: a person at the terminal, with ``limit`` seconds for an answer."""
    only(options, "limit")
    return TerminalSource(limit=seconds(options, "limit", ANSWER_LIMIT))


def person(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``person``: ``terminal`` if there is one, or no ROS 2, else ``topics``; with the options of that source."""
    name = "terminal" if is_terminal() or surroundings.ros is None else "topics"
    return make_source(SourceChoice(name, options), surroundings)


# --- options -------------------------------------------------------------------------------


def only(options: Mapping[str, object], *known: str) -> None:
    """Refuse unknown options, naming the nearest known one."""
    for name in options:
        if name not in known:
            hint = suggestion(str(name), known) or (f"expected {', '.join(known)}" if known else "it has no options")
            raise InputError(f"unknown option {name!r}; {hint}")


def text(options: Mapping[str, object], name: str, default: str) -> str:
    """Return an option, which must be a text."""
    value = options.get(name, default)
    if not isinstance(value, str):
        raise InputError(f"expected a text for {name}, found {value!r}")
    return value


def seconds(options: Mapping[str, object], name: str, default: float) -> float:
    """Return an option, which must be a number above 0."""
    value = options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise InputError(f"expected a number of seconds for {name}, found {value!r}")
    return float(value)


# --- the global knowledge in a database ----------------------------------------------------
# It is shared by runs, by processes and in PostgreSQL by hosts, and still there after all of them.
#
# SQLite keeps its promises when a process is killed, and lets others read while one writes (WAL). A value is stored,
# on the disk, before `update` returns.

LAYOUT: Final = Layout(
    "knowledge",
    0x504E4D4B,  # PNMK
    1,
    ("CREATE TABLE variables (name TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL, changed DOUBLE PRECISION NOT NULL, run TEXT NOT NULL)",),
)
_STORE: Final = (
    "INSERT INTO variables VALUES (:name, :value, :changed, :run)"
    " ON CONFLICT (name) DO UPDATE SET value = excluded.value, changed = excluded.changed, run = excluded.run"
)
_READ: Final = SqlQuery("SELECT value FROM variables WHERE name = :name", (str,))
_FORGET: Final = "DELETE FROM variables WHERE name = :name"


def default_path() -> Path:
    """Return the default path of the global knowledge; raise `SourceError` if the user has no home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        folder = Path(state) if Path(state).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError as error:
        raise SourceError(f"there is no place for the global knowledge: {error}; name a file") from error
    return folder / "pnm" / "knowledge.sqlite"


class DatabaseKnowledge:
    """Variables in an SQLite file, by default at `default_path`, or in PostgreSQL; one thread has the connection, opened when needed."""

    def __init__(self, place: Place | None = None) -> None:
        self.place = default_path() if place is None else place
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="knowledge")
        self._database: Database | None = None
        self._closed = False

    def __repr__(self) -> str:
        return f"<DatabaseKnowledge {self.place}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the value, or `MISSING`."""

        def read(database: Database) -> object:
            rows = database.read(_READ, name=question.name)
            return read_value(rows[0][0]) if rows else MISSING

        return await self._on_thread(read)

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value on the disk; one that is set to None is forgotten."""
        text = write_value(value)
        if value is None:
            await self._on_thread(lambda database: database.run(_FORGET, name=question.name))
        else:
            stored = {"name": question.name, "value": text, "changed": time(), "run": str(asker.run)}
            await self._on_thread(lambda database: database.run(_STORE, **stored))

    async def close(self) -> None:
        """Close the database when everything that was asked for is done."""
        if not self._closed:
            done = asyncio.get_running_loop().run_in_executor(self._thread, self._close)
            self._closed = True
            self._thread.shutdown(wait=False)
            await done

    async def _on_thread(self, work: Callable[[Database], T]) -> T:
        def on_thread() -> T:
            try:
                if self._database is None:
                    if isinstance(self.place, Path):
                        private_folder(self.place.parent)
                    self._database = Database(self.place, LAYOUT, is_durable=True)
                return work(self._database)
            except (DatabaseError, OSError) as error:
                self._close()  # the next one opens it anew: it may have been replaced, or its disk have space again
                raise SourceError(f"the knowledge in {self.place} cannot be used: {error}") from error

        if self._closed:
            raise SourceError(f"{self.place} is closed")
        return await asyncio.get_running_loop().run_in_executor(self._thread, on_thread)

    def _close(self) -> None:
        if self._database is not None:
            self._database.close()
            self._database = None
