"""Bindings of actions to action servers: which server, which goal fields, which limits.

Without a binding the server has the action's name and its goal fields are filled by name:
the call's arguments first, then local, then global variables. ``action``,
``arguments`` and ``duration`` are always there: the action's name, the list of its arguments, and
its planned duration in seconds, 0 when it has none.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Final, Protocol

from pnm.core.knowledge_base import KnowledgeBase, parse_fluent
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.conditions import Condition, Holds
from pnm.core.logic.effects import Changes
from pnm.core.logic.expressions import EXISTS, UNDEFINED, Fluent, Unknown, Value, bind
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.message_fields import Field, FieldValue, Test, Unreadable, fields_in, shown, succeeds, value_in, written
from pnm.errors import InputError, Position, check_counts, check_kinds, check_seconds

ABOUT_THE_CALL: Final = frozenset({"action", "arguments", "duration"})
"""Goal fields about the call itself; they are filled as long as the fields of the goal are not known."""

FOUND: Final = "?found"
"""Stands in facts for an object that was found."""
_NO_NAME: Final = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Table:
    """The value of a goal field by the value of a source: ``{of: "?to", table: {kitchen: {x: 1.0, y: 2.0}}}``."""

    of: object
    """A parameter, a variable or a fluent."""
    rows: Mapping[str, object]
    """Values by the text of the source's value; they are filled like goal fields."""


class Foreign(Enum):
    """The treatment of a server that works on goals of other programs."""

    WAIT = "wait"
    """Send nothing before they are over."""
    CANCEL = "cancel"
    """Cancel them, and send nothing before they are over."""
    SHARE = "share"
    """Send goals all the same: the server decides."""


class WhenLost(Enum):
    """The treatment of a request that its server had accepted, and does not know any more, or that is gone with it."""

    REPLAN = "replan"
    """It has failed: it is not made again where its effects are seen, else retried within the plan, else there is a new plan."""
    RESEND = "resend"
    """Send it again, once, if the server is back: to carry the action out twice does no harm."""
    ASK = "ask"
    """Ask a person whether it was carried out."""
    ABORT = "abort"
    """End the task: only people can know what the robot has done."""


@dataclass(frozen=True, slots=True)
class Found:
    """Objects that a result names: those that nobody has known are there from then on."""

    field: Field
    """A list of names, or of messages with a field ``name``."""
    types: tuple[str, ...]
    """Their type, then its supertypes, as far as these are known."""
    facts: tuple[Fluent, ...] = ()
    """What is so of each of them, which ``?found`` stands for."""
    limit: int = 10
    """The number of objects of the type that may be found altogether."""
    simulated: object = None
    """What simulated robots find, each object once: such a list, or a `Table` of such lists by an argument."""

    def facts_in(self, result: Mapping[str, object], action: GroundAction, world: KnowledgeBase) -> tuple[Changes, dict[Condition, str]]:
        """Return what is so of the objects that a result names; nothing, and why, if one of them cannot be there."""
        kind, there, wrong = self.types[0], {name.casefold(): name for name in world.objects(("object",))}, dict[Condition, str]()
        try:
            named = value_in(result, self.field)
            values = [_name_in(item) for item in (named if isinstance(named, list) else [named])]
        except Unreadable as error:
            return {}, {Holds((EXISTS, FOUND, kind)): str(error)}
        known, names = dict(there), set[str]()
        for value in sorted(values):
            name = self._name(value)
            names.add(name := known.get(value.casefold()) or known.setdefault(name.casefold(), name))
            if not name:
                wrong[Holds((EXISTS, shown(value), kind))] = f"{shown(value)} names no object"
            elif name.casefold() in there and name not in world.objects((kind,)):
                wrong[Holds((EXISTS, name, kind))] = f"{name} is no {kind}"
        new = sorted(names.difference(there.values()))
        count = len(new) + sum(kind in types for types in world.found().values())
        if new and count > self.limit:
            wrong[Holds((EXISTS, new[-1], kind))] = f"{count} objects of type {kind} were found then; expected {self.limit} at most"
        if wrong:
            return {}, wrong
        env = {f"?{name}": value for name, value in own_values(action).items()}
        facts: Changes = {(EXISTS, name, each): True for name in new for each in self.types}
        return facts | {bind(fact, {**env, FOUND: name}): True for name in sorted(names) for fact in self.facts}, {}

    def rehearsed(self, action: GroundAction, world: KnowledgeBase) -> list[object]:
        """Return what a simulated robot finds: of all that there is, what nobody has found before."""
        items, there = self.simulated, {name.casefold() for name in world.objects(("object",))}
        if isinstance(items, Table):
            items = items.rows.get(written(own_values(action).get(str(items.of)[1:])))
        return [item for item in (items if isinstance(items, list) else ()) if self._name(_name_in(item)).casefold() not in there]

    def _name(self, text: str) -> str:
        """Return the name of an object as PDDL has it, with a letter at its beginning; empty if the text has no letter and no digit."""
        name = _NO_NAME.sub("_", text).strip("_-")
        return name if not name or name[0].isalpha() else f"{self.types[0]}_{name}"


def _name_in(item: object) -> str:
    """Return the name in an item of a list; raise `Unreadable` for one without."""
    match item:
        case dict():
            return _name_in(value_in(item, Field(("name",))))
        case str() | int() if not isinstance(item, bool):
            return str(item)
        case _:
            raise Unreadable(f"{shown(item)} names no object")


@dataclass(frozen=True, slots=True)
class Binding:
    """Binding of one action; every field has a default."""

    server: str | None = None
    """Name of the action server; ``{robot}`` stands for the argument of parameter ``?robot``."""
    several_servers: bool = False
    """Whether there may be several servers of this name; all of them carry out every goal."""
    type: str | None = None
    """Such as ``nav2_msgs/action/NavigateToPose``; taken from the ROS graph when not given."""
    goal: Mapping[str, object] | None = None
    """Goal fields: ``?to`` a parameter, ``$name`` a variable, ``(pose ?to)`` a fluent, a `Table`, else a constant."""
    success: Test | None = None
    """A test of the result: a server that reports success has failed if it is false."""
    reason: FieldValue | None = None
    """The result field that says why the action failed, with a table of words if it is a number."""
    final: Test | None = None
    """A test of a failure's result: another attempt is useless, and the action is not tried again within the plan."""
    outcomes: Mapping[str, Test] = field(default_factory=dict)
    """Tests of the result that tell how the action has turned out, by the names of its outcomes; the first that succeeds counts."""
    store: Mapping[str, str] = field(default_factory=dict)
    """Result fields and the variables they are stored in, or the fluents that they set; every other field is stored by its own name."""
    found: Found | None = None
    """The objects that its result names."""
    seconds: float | Fluent | None = None
    """Seconds that the action is expected to take where the domain does not say so, or the function of its parameters that has them;
    None if nobody knows."""
    timeout: float | None = None
    """Seconds from acceptance until the action is cancelled; by default twice the planned duration, 10 at least."""
    accept: float = 20.0
    """Seconds the server may take to answer a goal. With those of a cancellation they are more than the lease of DDS and the grace of its
    client: a server that died before it answered is then known to be gone before the request is given up."""
    cancel: float = 5.0
    """Seconds the server may take to confirm a cancellation."""
    retries: int = 1
    """The number of further attempts within one plan."""
    ask: Mapping[str, str] = field(default_factory=dict)
    """Variables, and what a person is asked when their values are unknown; ``{shop}`` stands for the argument of parameter ``?shop``."""
    resources: tuple[str, ...] = ()
    """Resources that the action has for itself while it runs, such as ``{robot}/base``."""
    foreign: Foreign | None = None
    """The treatment of a server that works on goals of other programs; by default the action waits if it has resources."""
    when_lost: WhenLost = WhenLost.REPLAN
    """The treatment of a request whose end nobody knows any more."""
    position: Position | None = field(default=None, compare=False)
    """Its position in a file."""

    def __post_init__(self) -> None:
        seconds = None if isinstance(self.seconds, tuple) else self.seconds
        check_seconds(f"the binding of {self.server or 'an action'}", seconds, self.timeout, self.accept, self.cancel)
        check_counts(f"the binding of {self.server or 'an action'}", retries=self.retries)

    def judged(self, outcome: Outcome) -> Outcome:
        """Return the outcome as the result has it: a success that it denies is an abort, a failure has its reason and may be final."""
        look, kind, message, seen = partial(value_in, outcome.result), outcome.kind, outcome.message, ""
        has_ended = kind in (OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED)
        for name, test in self.outcomes.items() if has_ended else ():
            with suppress(Unreadable):  # a result that says nothing of it leaves it to what is reported
                if succeeds(test, look):
                    return replace(outcome, kind=OutcomeKind.SUCCEEDED, declared=name)
        if has_ended and self.success is not None:
            try:
                if not succeeds(self.success, look):
                    kind, values = OutcomeKind.ABORTED, [f"{where} = {shown(look(where))}" for where in fields_in(self.success)]
                    seen = f"its result has {', '.join(dict.fromkeys(values))}"
            except Unreadable as error:
                if kind is OutcomeKind.SUCCEEDED:
                    kind, message = OutcomeKind.ABORTED, f"its result does not tell whether it succeeded: {error}"
        if kind is not OutcomeKind.SUCCEEDED and self.reason is not None and outcome.result:
            try:
                message = str(self.reason.value(look)) or message
            except Unreadable as error:
                message = message or str(error)
        if kind is OutcomeKind.ABORTED and self.final is not None:
            with suppress(Unreadable):  # a result that says nothing of it does not keep the action from being tried again
                kind = OutcomeKind.ABORTED_FOR_GOOD if succeeds(self.final, look) else kind
        return replace(outcome, kind=kind, message=message or seen)


DEFAULT = Binding()
_NAME = re.compile(r"[A-Za-z][\w-]*\Z")


@dataclass(frozen=True, slots=True)
class Bindings:
    """Bindings by action name, and the fluents without sensors."""

    actions: Mapping[str, Binding] = field(default_factory=dict)
    assumed: frozenset[str] = frozenset()
    """Predicates and functions that no sensor reports, even in simulation."""
    lag: float = 1.0
    """Seconds that reports about sensed fluents may be late."""

    def __post_init__(self) -> None:
        check_seconds("a report", self.lag)
        check_kinds("bindings", {name: (binding, Binding) for name, binding in self.actions.items()})

    def of(self, action: str) -> Binding:
        """Return the binding of the action, or the default one."""
        return self.actions.get(action, DEFAULT)

    def before(self, others: Bindings) -> Bindings:
        """Return these bindings and, for actions that they do not speak of, others."""
        return Bindings({**others.actions, **self.actions}, self.assumed | others.assumed, max(self.lag, others.lag))

    def server(self, action: GroundAction) -> str:
        """Return the name of the server that performs the ground action.

        Raises:
            InputError: the name has a part in braces that is not a parameter of the action.
        """
        return _filled(self.of(action.name).server or action.name, action, "server")

    def resources(self, action: GroundAction) -> tuple[str, ...]:
        """Return the exclusive resources of the running ground action: its own, and those of its binding.

        Work on knowledge has none. A name that depends on an open parameter is only known when the call starts; see `is_open`.

        Raises:
            InputError: a name has a part in braces that is not a parameter of the action.
        """
        if action.operation is not None:
            return ()
        patterns = (*action.resources, *self.of(action.name).resources)
        return tuple(dict.fromkeys(_filled(pattern, action, "resource") for pattern in patterns)) if patterns else ()

    def named(self, action: GroundAction, names: Collection[str]) -> str:
        """Return the first of these robots, objects and resources that the ground action needs; empty if it needs none of them.

        It needs its arguments, its resources, and the parts of their names. Work on knowledge needs nothing.
        """
        if action.operation is not None:
            return ""
        needed = (*action.arguments, *with_parts(self.resources(action)))
        return next((name for name in needed if name in names), "")

    def names_server(self, action: GroundAction) -> bool:
        """Return whether the name of the server is known, or has a part that is only known when the call starts."""
        return not set(placeholders(self.of(action.name).server or "")) & set(open_parameters(action))

    def timeout(self, action: GroundAction) -> float:
        """Return the limit of the running action in seconds."""
        chosen = self.of(action.name).timeout
        return chosen if chosen is not None else max(10.0, 2.0 * (action.duration or 0.0), 60.0 if action.duration is None else 0.0)


NO_BINDINGS: Final = Bindings()
"""Those of servers that are called as the actions, with goals that are filled by name."""


def with_parts(resources: Iterable[str]) -> Iterator[str]:
    """Yield resources, each with the parts of its name behind it: `r1` is a part of ``r1/base``."""
    return (part for name in resources for part in (name, *name.split("/")))


def is_open(resource: str) -> bool:
    """Return whether the name of a resource depends on an argument that has no value before its call starts."""
    return "?" in resource  # such arguments begin with it


def _filled(pattern: str, action: GroundAction, what: str) -> str:
    own = dict(zip(action.parameters, action.arguments, strict=True))
    for name in placeholders(pattern):
        if name not in own:
            raise InputError(f"the {what} {pattern!r} of {action.name} names {{{name}}}, which is not a parameter ({', '.join(own)})")
    return pattern.format_map(own)


class Lookup(Protocol):
    """Source of values for goal fields, besides the call itself."""

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a fluent."""

    def variable(self, name: str, /) -> object:
        """Return a variable that is known here, or `MISSING`."""

    def find(self, name: str, /) -> object:
        """Return a variable that is needed: from wherever it can be had, or `MISSING`."""

    def given(self) -> Mapping[str, object]:
        """Return the values that the plan gives to goal fields or leaves open, as far as there are any."""


def goal_data(
    action: GroundAction, binding: Binding, fields: tuple[str, ...] | None, knowledge: Lookup
) -> tuple[dict[str, object], tuple[str, ...]]:
    """Fill the goal fields by name; return them and the names of those for which there is no value.

    With a `goal` mapping only its fields are needed; others are filled if a value of their name exists.
    As long as the fields of the goal are not known, parameters without a value are needed.
    """
    own = {**own_values(action), **knowledge.given()}
    needed = binding.goal if binding.goal is not None else dict.fromkeys(fields if fields is not None else open_parameters(action))
    wanted = dict.fromkeys((*needed, *(fields if fields is not None else own)))
    if binding.goal is None and wanted.keys() <= own.keys():  # the call has all of them
        return {name: own[name] for name in wanted}, ()
    filled: dict[str, object] = {}
    missing: list[str] = []
    for name in wanted:
        source = needed[name] if binding.goal is not None and name in needed else f"${name}"
        value = _resolve(source, own, knowledge, knowledge.find if name in needed else knowledge.variable)
        if value is not MISSING:
            filled[name] = value
        elif name in needed:
            missing.append(name)
    return filled, tuple(missing)


def own_values(action: GroundAction) -> dict[str, object]:
    """Return the values that an action has for goal fields by itself, by name."""
    arguments = {name: value for name, value in zip(action.parameters, action.arguments, strict=True) if not value.startswith("?")}
    return {"action": action.name, "arguments": list(action.arguments), "duration": action.duration or 0.0, **arguments}


def open_parameters(action: GroundAction) -> tuple[str, ...]:
    """Return the parameters whose values the plan leaves open, without ``?``."""
    return tuple([name for name, value in zip(action.parameters, action.arguments, strict=True) if value.startswith("?")])


def _resolve(source: object, own: Mapping[str, object], knowledge: Lookup, find: Callable[[str], object]) -> object:
    if isinstance(source, Table):
        key = _resolve(source.of, own, knowledge, find)
        return MISSING if key is MISSING else _resolve(source.rows.get(written(key), MISSING), own, knowledge, find)
    if isinstance(source, Mapping):
        inner = {name: _resolve(part, own, knowledge, find) for name, part in source.items()}
        return MISSING if MISSING in inner.values() else inner
    if isinstance(source, list | tuple):
        parts = [_resolve(part, own, knowledge, find) for part in source]
        return MISSING if MISSING in parts else parts
    if not isinstance(source, str):
        return source
    if source.startswith("?"):
        return own.get(source[1:], MISSING)
    if source.startswith("$"):
        return own[source[1:]] if source[1:] in own else find(source[1:])
    if source.startswith("("):
        value = knowledge.value(bind(parse_fluent(source), {f"?{name}": value for name, value in own.items()}))
        return MISSING if value in (None, UNDEFINED) or isinstance(value, Unknown) else value
    return source


def placeholders(pattern: str) -> Iterator[str]:
    """Yield the parameters named in the braces of a pattern."""
    for _, name, _, _ in string.Formatter().parse(pattern):
        if name is not None:
            yield name
