"""Sources by name: files name them, and nothing but what is registered here can be named.

A package of somebody else registers its own with an entry point in the group ``pnm.sources``, or ``pnm.people`` if it
speaks for people; a program with `register_source`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final, TypeAlias

from pnm.errors import InputError, Position
from pnm.nearest import meant
from pnm.queries import Layer
from pnm.sources.base import Source
from pnm.sources.chain import GRACE, LIMIT, PERSON_LIMIT, Sources

GROUPS: Final = {"pnm.sources": Layer.GLOBAL, "pnm.people": Layer.PERSON}
"""The groups of entry points, and whom the sources in them speak for."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What sources are made in."""

    ros: Any = None
    """The `pnm.ros.node.RosThread` of this process; None when it has none."""
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
    "sqlite": ("pnm.sources.factories:sqlite", Layer.GLOBAL),
    "memory": ("pnm.sources.factories:memory", Layer.GLOBAL),
    "ros2": ("pnm.ros.knowledge_client:ros2", Layer.GLOBAL),
    "person": ("pnm.sources.factories:person", Layer.PERSON),
    "terminal": ("pnm.sources.factories:terminal", Layer.PERSON),
    "topics": ("pnm.ros.person:topics", Layer.PERSON),
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
    near = meant(name, names) or meant(name.rpartition(".")[2], names)
    hint = near or f"expected one of {', '.join(name for name in names if name not in _ORIGINAL)}"
    how = (
        f"to add one, call pnm.sources.register_source({name!r}, factory), or have a package declare an entry point in {next(iter(GROUPS))}"
    )
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
