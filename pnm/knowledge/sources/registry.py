"""The registry of knowledge sources: files choose a registered source by its name, and give it options.

A package registers a source with an entry point in the group ``pnm.knowledge.sources``, or ``pnm.people`` if the source
stands for a person; a program with `register_source`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final, TypeAlias

from pnm.core.execution.questions import LIMITS
from pnm.core.logic.computed_values import Layer
from pnm.errors import InputError, Position, suggestion
from pnm.files.database.place import Place, ServerUrl
from pnm.knowledge.sources import person_text as people
from pnm.knowledge.sources.database import DatabaseKnowledge
from pnm.knowledge.sources.memory import MemoryKnowledge
from pnm.knowledge.sources.router import GRACE, LIMIT, PERSON_LIMIT, Sources
from pnm.knowledge.sources.scripted import ScriptedAnswers
from pnm.knowledge.sources.source import Source
from pnm.knowledge.sources.terminal import TerminalSource, is_terminal

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
    "sqlite": ("pnm.knowledge.sources.registry:sqlite", Layer.GLOBAL),
    "postgres": ("pnm.knowledge.sources.registry:postgres", Layer.GLOBAL),
    "memory": ("pnm.knowledge.sources.registry:memory", Layer.GLOBAL),
    "ros2": ("pnm.ros.knowledge.knowledge_source:ros2", Layer.GLOBAL),
    "person": ("pnm.knowledge.sources.registry:person", Layer.PERSON),
    "terminal": ("pnm.knowledge.sources.registry:terminal", Layer.PERSON),
    "topics": ("pnm.ros.knowledge.person_source:topics", Layer.PERSON),
}
"""The built-in sources, loaded like those of other packages, so that nothing here imports ROS 2."""
_DEFAULTS: Final = {Layer.GLOBAL: SourceChoice("sqlite"), Layer.PERSON: SourceChoice("person")}
"""The sources used when none is chosen."""
_ORIGINAL: Final = dict.fromkeys(("RPKnowledgeBase", "ROSExternalKnowledgeBase", "ExternalKnowledgeBase"), _DEFAULTS[Layer.GLOBAL].name)
"""Classes named in files for the original implementation, with the sources used in their place."""
_registered: Final[dict[str, _Registered]] = {}


def register_source(name: str, factory: Factory, *, layer: Layer = Layer.GLOBAL) -> None:
    """Register a source that files can choose; one of the same name is replaced.

    Args:
        name: such as ``ontology``, or the ``module.class`` that a file for the original implementation names.
        factory: makes it, given its options and `Surroundings`; a class that takes these will do.
        layer: `Layer.PERSON` if it stands for a person.
    """
    _registered[name] = _Registered(lambda: factory, layer)


def source_names() -> tuple[str, ...]:
    """Return the names of all registered sources."""
    return tuple(sorted(_all()))


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
    """Return the time limit in seconds for any of them; a source with a ``limit`` of its own keeps that itself, hence the grace.

    Raises:
        InputError: a source would take longer than runs wait.
    """
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
    own = {name: _Registered(EntryPoint(name, value, "").load, layer) for name, (value, layer) in _OWN.items()}
    original = {name: own[ours] for name, ours in _ORIGINAL.items()}
    packages = {entry.name: _Registered(entry.load, layer) for group, layer in GROUPS.items() for entry in entry_points(group=group)}
    return {**original, **own, **packages, **_registered}


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
    return TerminalSource(limit=seconds(options, "limit", people.LIMIT))


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
