"""Sources by name: files name them, and nothing but what is registered here can be named.

A package of somebody else registers its own with an entry point in the group ``pnm.knowledge.sources``, or ``pnm.people`` if it
speaks for people; a program with `register_source`.

How the built-in sources are made from the options in a file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final, TypeAlias

from pnm.core.logic.computed_values import Layer
from pnm.errors import InputError, Position, suggestion
from pnm.knowledge.sources import person_text as people
from pnm.knowledge.sources.memory import MemoryKnowledge
from pnm.knowledge.sources.router import GRACE, LIMIT, PERSON_LIMIT, Sources
from pnm.knowledge.sources.source import Source
from pnm.knowledge.sources.sqlite import SqliteKnowledge
from pnm.knowledge.sources.terminal import TerminalSource, is_terminal

GROUPS: Final = {"pnm.knowledge.sources": Layer.GLOBAL, "pnm.people": Layer.PERSON}
"""The groups of entry points, and whom the sources in them speak for."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What sources are made in."""

    ros: Any = None
    """The `pnm.ros.node.ros_thread.RosThread` of this process; None when it has none."""
    folder: Path = field(default_factory=Path)
    """What paths in the options are relative to."""


Factory: TypeAlias = Callable[[Mapping[str, object], Surroundings], Source]
"""Makes a source, given its options; raises `InputError` or `SourceError`. An option ``limit`` is the seconds it may take."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A source that a file names, and what it says about it."""

    name: str
    options: Mapping[str, object] = field(default_factory=dict)
    position: Position | None = None


@dataclass(frozen=True, slots=True)
class _Registered:
    load: Callable[[], Factory]
    layer: Layer


_OWN: Final = {
    "sqlite": ("pnm.knowledge.sources.registry:sqlite", Layer.GLOBAL),
    "memory": ("pnm.knowledge.sources.registry:memory", Layer.GLOBAL),
    "ros2": ("pnm.ros.knowledge.knowledge_source:ros2", Layer.GLOBAL),
    "person": ("pnm.knowledge.sources.registry:person", Layer.PERSON),
    "terminal": ("pnm.knowledge.sources.registry:terminal", Layer.PERSON),
    "topics": ("pnm.ros.knowledge.person_source:topics", Layer.PERSON),
}
"""Built in, and loaded like those of others: nothing here imports ROS 2."""
_DEFAULTS: Final = {Layer.GLOBAL: Choice("sqlite"), Layer.PERSON: Choice("person")}
"""What is used when nothing is chosen."""
_ORIGINAL: Final = dict.fromkeys(("RPKnowledgeBase", "ROSExternalKnowledgeBase", "ExternalKnowledgeBase"), _DEFAULTS[Layer.GLOBAL].name)
"""Classes that files for the original implementation name, and what they get here."""
_registered: Final[dict[str, _Registered]] = {}


def register_source(name: str, factory: Factory, *, layer: Layer = Layer.GLOBAL) -> None:
    """Let files name a source; one of the same name is replaced.

    Args:
        name: such as ``ontology``, or the ``module.class`` that a file for the original implementation names.
        factory: makes it, given its options and `Surroundings`; whole classes that take these will do.
        layer: `Layer.PERSON` if it speaks for people.
    """
    _registered[name] = _Registered(lambda: factory, layer)


def source_names() -> tuple[str, ...]:
    """Return all names that files may use."""
    return tuple(sorted(_all()))


def check_source(name: str, position: Position | None = None) -> str:
    """Return the registered name that is meant: the name itself, or that of the last part of ``module.class``.

    Raises:
        InputError: there is none; the message names the nearest and says how to register one.
    """
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


def open_sources(choices: Sequence[Choice], surroundings: Surroundings, file: Path | None = None) -> Sources:
    """Make the sources that were chosen, and the default ones where none was: the file of this user, and a person.

    Nothing is opened or asked yet: what a source lacks is said when it is needed.

    Args:
        choices: what files chose.
        surroundings: what sources are made in.
        file: what global knowledge is kept in, whatever was chosen for it; an SQLite file.

    Raises:
        InputError: a name or an option is wrong, or there are two people.
        SourceError: a source cannot be made here.
    """
    chosen: dict[Layer, list[Choice]] = {layer: [] for layer in _DEFAULTS}
    if file is not None:
        chosen[Layer.GLOBAL].append(Choice("sqlite", {"file": str(file.absolute())}))
    for choice in choices:
        layer = _all()[check_source(choice.name, choice.position)].layer
        if layer is Layer.PERSON and chosen[layer]:
            raise InputError(f"{choice.name} speaks for people, and so does another source; expected one of them", choice.position)
        if layer is Layer.PERSON or file is None:
            chosen[layer].append(choice)
    shared, people = (chosen[layer] or [default] for layer, default in _DEFAULTS.items())
    return Sources(
        [make_source(choice, surroundings) for choice in shared],
        make_source(people[0], surroundings),
        limit=_patience(shared, LIMIT),
        person_limit=_patience(people, PERSON_LIMIT),
    )


def _patience(choices: Sequence[Choice], default: float) -> float:
    """Return the seconds to wait for any of them: a ``limit`` that is chosen is theirs to keep."""
    limits = (choice.options.get("limit") for choice in choices)
    return max([default, *(limit + GRACE for limit in limits if isinstance(limit, int | float))])


def make_source(choice: Choice, surroundings: Surroundings) -> Source:
    """Make one source.

    Raises:
        InputError: its name or an option is wrong.
        SourceError: it cannot be made here.
    """
    try:
        return _all()[check_source(choice.name, choice.position)].load()(choice.options, surroundings)
    except InputError as error:
        raise error if error.position else InputError(f"{choice.name}: {error.message}", choice.position) from error
    except (ImportError, AttributeError) as error:
        raise InputError(f"the source {choice.name!r} is registered but cannot be loaded: {error}", choice.position) from error


def _all() -> dict[str, _Registered]:
    """Return what is registered, by name; programs go before packages, and those before what is built in."""
    own = {name: _Registered(EntryPoint(name, value, "").load, layer) for name, (value, layer) in _OWN.items()}
    original = {name: own[ours] for name, ours in _ORIGINAL.items()}
    packages = {entry.name: _Registered(entry.load, layer) for group, layer in GROUPS.items() for entry in entry_points(group=group)}
    return {**original, **own, **packages, **_registered}


def memory(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make knowledge that lasts as long as the process; it has no options."""
    only(options)
    return MemoryKnowledge()


def sqlite(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make knowledge in a ``file``; the user's own when none is named."""
    only(options, "file")
    file = text(options, "file", "")
    return SqliteKnowledge(surroundings.folder / Path(file).expanduser() if file else None)


def terminal(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make a person at the terminal, who has so many seconds (``limit``) for an answer."""
    only(options, "limit")
    return TerminalSource(limit=seconds(options, "limit", people.LIMIT))


def person(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make a person at the terminal if there is one, or no ROS 2; otherwise one behind topics. Options are theirs."""
    found = "terminal" if is_terminal() or surroundings.ros is None else "topics"
    return make_source(Choice(found, options), surroundings)


# --- options -------------------------------------------------------------------------------


def only(options: Mapping[str, object], *known: str) -> None:
    """Refuse every option but the known ones, naming the nearest.

    Raises:
        InputError: there is another.
    """
    for name in options:
        if name not in known:
            hint = suggestion(str(name), known) or (f"expected {', '.join(known)}" if known else "it has no options")
            raise InputError(f"unknown option {name!r}; {hint}")


def text(options: Mapping[str, object], name: str, default: str) -> str:
    """Return an option that is a text.

    Raises:
        InputError: it is something else.
    """
    value = options.get(name, default)
    if not isinstance(value, str):
        raise InputError(f"expected a text for {name}, found {value!r}")
    return value


def seconds(options: Mapping[str, object], name: str, default: float) -> float:
    """Return an option that is a number above 0.

    Raises:
        InputError: it is something else.
    """
    value = options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise InputError(f"expected a number of seconds for {name}, found {value!r}")
    return float(value)
