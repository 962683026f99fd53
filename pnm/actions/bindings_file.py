"""Bindings files: which server, goal fields, limits and resources an action has, as YAML."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Final

from pnm.core.knowledge_base import parse_fluent
from pnm.core.logic.domain import FluentKind, Vocabulary
from pnm.core.logic.expressions import Fluent
from pnm.core.machine.bindings import _NAME, DEFAULT, NO_BINDINGS, Binding, Bindings, Foreign, Found, Table, WhenLost, placeholders
from pnm.errors import InputError, Position, located
from pnm.files.yaml_keys import (
    ANYTHING,
    TEXT,
    Keys,
    Schema,
    choice,
    each,
    flag,
    names,
    needed,
    node,
    number,
    ref,
    section,
    text,
    texts,
    whole,
)
from pnm.files.yaml_nodes import Mapped, Node, load_yaml
from pnm.knowledge.sensor_file import FieldTest, TabledField, field_test, field_value, read_field

_SERVER: Final = re.compile(r"~?[\w/{}]+", re.ASCII)
"""The name of an action server, in whose braces parameters stand."""
_TYPE: Final = re.compile(r"[a-z][a-z0-9_]*/action/[A-Z][A-Za-z0-9]*")


class FoundKeys(Keys):
    """Objects that the result of an action names."""

    field = needed(TEXT, "a result field: a list of names, or of messages with a field `name`")
    type = needed(TEXT, "the type of those that the problem does not have")
    facts = names("what is so of each of them, with `?found` for it", "nothing")
    limit = whole("objects of the type that may be found altogether", 10, least=1)
    simulated = node(
        {"type": ["array", "object"]}, "what simulated robots find, each object once: such a list, or a table of them", "nothing"
    )


class BindingKeys(Keys):
    """The binding of an action to its server."""

    server = text(
        "name of the action server; `{robot}` stands for the argument of `?robot`. A name without `/` is relative to the node",
        "the action's name",
    )
    several_servers = flag("`true` if several servers may have this name; all of them carry out every goal", "refused")
    ros_type = text("such as `nav2_msgs/action/NavigateToPose`", "found in the ROS graph").named("type")
    goal = node(
        {"type": ["object", "null"]},
        "goal fields: `?to` a parameter, `$name` a variable, `(pose ?to)` a function, "
        '`{of: "?to", table: {kitchen: …}}` a row of a table, else a constant',
        "by name",
    )
    success = node(
        ref("fieldTest"), "test of the result of a server that always succeeds: `{field: status.code, eq: 0}`", "success as reported"
    )
    reason = node(
        {"if": {"type": "object"}, "then": TabledField.json(), "else": {"type": ["string", "null"]}},
        "the result field with the reason of a failure; with a table for numbers: `{field: code, table: {1: no path}}`",
        "`message`, `error_msg`, `error_string`",
    )
    final = node(
        ref("fieldTest"),
        "test of the result: another attempt is useless, so the call is not tried again in this plan",
        "another attempt may help",
    )
    told = section(
        ref("fieldTest"),
        "outcomes of the domain and tests of the result that tell them: `{slipped: {field: code, eq: 3}}`; the first that passes counts. "
        "Without names they are called `1`, `2` and so on",
        "sensors tell them",
    ).named("outcomes")
    store = texts(
        "expected result fields and the variables to store them in",
        "result fields, and the variables that keep them, or the facts and functions that they set: "
        '`{time: travel_time, degrees: "(temperature ?room)"}`',
        "every field, by its own name",
    )
    found = node(
        FoundKeys.json(or_null=True),
        "objects that a result names, and that the problem need not know: "
        '`{field: objects, type: cup, facts: ["(in ?found ?room)"], limit: 10}`',
        "none",
    )
    seconds = node(
        {"type": ["number", "string", "null"], "minimum": 0},
        "seconds that the action is expected to take, where the domain gives no duration: plans are measured by it. "
        "A number, or a function of the problem: `(drive_time ?from ?to)`",
        "1",
    )
    timeout = number(
        "seconds from acceptance until the goal is cancelled", None, "twice the planned duration, 10 at least; 60 without a duration"
    )
    accept = number("seconds for the server to answer a goal", DEFAULT.accept)
    cancel = number("seconds for the server to confirm a cancellation", DEFAULT.cancel)
    retries = whole(
        "further attempts of a failed call within one plan, without a recovery; a rest of the plan that still works is another plan",
        DEFAULT.retries,
    )
    ask = texts(
        "expected variables, and questions to a person when they are unknown",
        'variables, and questions to a person when they are unknown: `{drink: "What would {guest} like?"}`',
        "nobody is asked",
    )
    resources = names('exclusive resources of a running call: `[arm]`, `["{robot}/base"]`. Calls with the same resource take turns', "none")
    foreign = choice(
        Foreign,
        "while the server works for other programs: `wait` for them, `cancel` them, or `share` the server",
        "`wait` if there are resources, else `share`",
    )
    when_lost = choice(
        WhenLost,
        "when a restarted server does not know the call: `replan` (it has failed, and is not repeated where its effects are observed), "
        "`resend` it once, `ask` a person, `abort` the task",
        "`replan`",
    )


DEFINITIONS: Final[Mapping[str, Schema]] = {"fieldTest": FieldTest.json()}
"""The definitions of a schema for the parts of bindings."""


class BindingsFile(Keys):
    """A file of bindings."""

    actions = each(BindingKeys, ANYTHING, "the bindings, by action", "none")
    assumed = names("predicates and functions without a sensor, also in simulation", "all that nothing reports")
    lag = number("seconds by which reports may be late: checks wait so long for an effect", NO_BINDINGS.lag)


def read_bindings(path: Path | str, known: Vocabulary | None = None) -> Bindings:
    """Read a bindings file, its names checked against the known ones if given; raise `InputError` where something is wrong."""
    return bindings_in(load_yaml(path), known)


def bindings_in(top: Mapped, known: Vocabulary | None = None, *, strangers: bool = False) -> Bindings:
    """Return the bindings of a loaded file, as `read_bindings` does; with `strangers`, actions need not be declared."""
    file = BindingsFile(top)
    for key, where, value in top.section("actions").entries():
        if key in BindingKeys.known and not (value.is_mapping or value.is_null):
            raise InputError(f"{key!r} belongs under an action: two more spaces before it", where)
    entries = file.actions
    declared = entries if known is None or not strangers else known.actions
    actions = {name: read_binding(keys, name, known if name in declared else None) for name, keys in entries.items()}
    if known is not None:
        for name, keys in entries.items():
            entry = keys.entry
            if strangers and name not in known.actions:
                continue
            known.check_action(name, entry.start)
            for parameter in placeholders(actions[name].server or ""):
                known.check_parameter(name, parameter, entry.position("server"))
            for pattern, position in _read_resources(keys):
                for parameter in placeholders(pattern):
                    known.check_parameter(name, parameter, position)
            if keys.goal is not None:
                _check_sources(keys.goal, name, known)
            for outcome, where, _ in keys.told.entries():
                known.check_outcome(name, outcome, where)
            if isinstance(seconds := actions[name].seconds, tuple):
                known.check_kind(seconds[0], FluentKind.NUMBER, entry.position("seconds"))
                known.check_stored(name, seconds, entry.position("seconds"))
            for fluent, value in stored_fluents(keys.store, entry):
                known.check_stored(name, fluent, value.position)
        for name in () if strangers else file.assumed:
            known.check_set(name, top.position("assumed"))
    return Bindings(actions, frozenset(file.assumed), file.lag)


def stored_fluents(store: Mapping[str, str], entry: Mapped) -> Iterator[tuple[Fluent, Node]]:
    """Yield the fluents that the fields of a result set by the key ``store`` of the mapping, and where they stand."""
    for name, target in store.items():
        if target.startswith("("):
            _, value = entry.section("store").nodes[name]
            with located(value.position):
                fluent = parse_fluent(target)
            yield fluent, value


def _seconds(keys: BindingKeys) -> float | Fluent | None:
    """Read how long an action is expected to take: a number, or a function of its parameters."""
    if keys.seconds is None or keys.seconds.text is None or not keys.seconds.text.startswith("("):
        return keys.entry.number("seconds", None)
    with located(keys.seconds.position):
        return parse_fluent(keys.seconds.text)


def _found(keys: FoundKeys, action: str, known: Vocabulary | None) -> Found:
    """Read which objects a result names."""
    kind, types, facts = keys.type.text or "", frozenset[str](), list[Fluent]()
    if known is not None:
        known.check_type(kind, keys.type.position)
        types = known.types[kind] - {kind, "object"}
    for fact, item in zip(keys.facts, keys.entry.listed("facts"), strict=True):
        with located(item.position):
            facts.append(parse_fluent(fact))
        if known is not None:
            known.check_kind(facts[-1][0], FluentKind.FACT, item.position)
            known.check_stored(action, facts[-1], item.position, (kind,))
    source = None if keys.simulated is None else _source(keys.simulated)
    rows = [*source.rows.values()] if isinstance(source, Table) else [source or []]
    named = [item.get("name") if isinstance(item, dict) else item for row in rows for item in (row if isinstance(row, list) else [None])]
    if keys.simulated is not None and not all(isinstance(name, str | int) for name in named):
        raise keys.simulated.wrong("expected a list of names, or a table of such lists by a parameter")
    if known is not None and keys.simulated is not None and isinstance(source, Table):
        known.check_parameter(action, str(source.of)[1:], keys.simulated.position)
    return Found(read_field(keys.entry), (kind, *sorted(types)), tuple(facts), keys.limit, source)


def read_binding(keys: BindingKeys, action: str = "", known: Vocabulary | None = None) -> Binding:
    """Read the binding of one action; where names are known, those of the objects that it finds are checked."""
    entry, goal, success, reason, final, store = keys.entry, keys.goal, keys.success, keys.reason, keys.final, keys.store
    tuple(stored_fluents(store, entry))  # which refuses what stands in parentheses and is none
    if goal is not None and not goal.is_mapping:
        raise goal.wrong("expected goal fields and their values")
    server, action_type, type_key = keys.server, keys.ros_type, type(keys).ros_type.name
    if server is not None:
        check_pattern(server, entry.position("server"), "/{robot}/navigate")
        if _SERVER.fullmatch(server) is None:
            raise InputError(f"{server!r} cannot name an action server; expected letters, digits, _ and /", entry.position("server"))
    if action_type is not None and _TYPE.fullmatch(action_type) is None:
        example = "nav2_msgs/action/NavigateToPose"
        raise InputError(f"expected a type such as {example} under {type_key!r}, found {action_type!r}", entry.position(type_key))
    return Binding(
        server=server,
        several_servers=keys.several_servers,
        type=action_type,
        goal=None if goal is None else {name: _source(part) for name, _, part in goal.mapped().entries()},
        success=None if success is None else field_test(success),
        reason=None if reason is None else field_value(reason),
        final=None if final is None else field_test(final),
        outcomes={name: field_test(test) for name, _, test in keys.told.entries()},
        store=store,
        found=None if keys.found is None else _found(FoundKeys(keys.found.mapped()), action, known),
        seconds=_seconds(keys),
        timeout=keys.timeout,
        accept=keys.accept,
        cancel=keys.cancel,
        retries=keys.retries,
        ask=keys.ask,
        resources=tuple(dict.fromkeys(name for name, _ in _read_resources(keys))),
        foreign=keys.foreign,
        when_lost=keys.when_lost or DEFAULT.when_lost,
        position=entry.start,
    )


def _source(node: Node) -> object:
    """Return the source of a goal field; it may be inside of others."""
    if (parts := _table(node)) is not None:
        of, rows = parts
        return Table(_source(of), {name: _source(row) for name, _, row in rows.entries()})
    if node.is_mapping:
        return {name: _source(part) for name, _, part in node.mapped().entries()}
    if node.items is not None:
        return [_source(item) for item in node.items]
    if node.text is not None and node.text.startswith("("):
        with located(node.position):
            parse_fluent(node.text)
    return node.plain()


def _table(node: Node) -> tuple[Node, Mapped] | None:
    """Return the key of a table, and its rows; None for anything else."""
    if not node.is_mapping or node.mapped().nodes.keys() != {"of", "table"}:
        return None
    of, rows = node.mapped().needed("of"), node.mapped().needed("table")
    if (of.text or "")[:1] not in ("?", "$", "("):
        raise of.wrong("expected a parameter such as ?to, a variable such as $place, or a function such as (home ?robot)")
    if not rows.is_mapping or not rows.mapped().nodes:
        raise rows.wrong(f"expected values of {of.text} and their values for the field")
    return of, rows.mapped()


def _check_sources(node: Node, action: str, known: Vocabulary) -> None:
    """Refuse parameters that the action does not have, and tables without a row for an object that a parameter, or a function, may be."""
    if (parts := _table(node)) is not None:
        of, rows = parts
        _check_sources(of, action, known)
        text = of.text or ""
        is_function, is_parameter = text.startswith("("), text.startswith("?")
        objects = known.values(parse_fluent(text)[0]) if is_function else known.arguments(action, text[1:]) if is_parameter else ()
        for name, where, _ in rows.entries():
            if objects and name in known.types_of and name not in objects:  # other problems may have other objects
                raise InputError(f"{of.text} of {action} cannot be {name}; expected one of {', '.join(objects)}", where)
        if absent := [name for name in objects if name not in rows.nodes]:
            raise InputError(f"the table has no row for {', '.join(absent)}, which {of.text} of {action} may be", rows.start)
        inner = [row for _, _, row in rows.entries()]
    elif node.is_mapping:
        inner = [part for _, _, part in node.mapped().entries()]
    else:
        inner = list(node.items or ())
    for part in inner:
        _check_sources(part, action, known)
    if node.text is not None:  # a parameter, or a fluent with parameters
        for term in parse_fluent(node.text) if node.text.startswith("(") else (node.text,):
            if term.startswith("?"):
                known.check_parameter(action, term[1:], node.position)


def _read_resources(keys: BindingKeys) -> Iterator[tuple[str, Position]]:
    names, written = keys.resources, keys.entry.node("resources")
    items = (written.items if written else None) or ()
    for name, item in zip(names, items, strict=True):
        check_pattern(name, item.position, "{robot}/base")
        yield name, item.position


def check_pattern(pattern: str, position: Position, example: str, parameters: Collection[str] | None = None) -> None:
    """Refuse the pattern of a name that has in braces what is no parameter: none of these, or, without them, not even a name."""
    try:
        names = [*placeholders(pattern)]
        wrong = [f"{{{name}}} is no parameter" for name in names if not (_NAME.match(name) if parameters is None else name in parameters)]
    except ValueError as error:
        wrong = [str(error)]
    if wrong:
        raise InputError(f"{wrong[0]} in {pattern!r}; expected something like {example}", position)
