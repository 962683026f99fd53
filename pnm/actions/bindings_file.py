"""Bindings files: which server, goal fields, limits and resources an action has, as YAML."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Final

from pnm.core.knowledge_base import parse_fluent
from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.bindings import _NAME, DEFAULT, Binding, Bindings, Foreign, Table, WhenLost, placeholders
from pnm.errors import InputError, Position
from pnm.files.yaml_nodes import Mapped, Node, load_yaml
from pnm.knowledge.field_reader import field_test, field_value

_SERVER: Final = re.compile(r"~?[\w/{}]+", re.ASCII)
"""The name of an action server, in whose braces parameters stand."""
_TYPE: Final = re.compile(r"[a-z][a-z0-9_]*/action/[A-Z][A-Za-z0-9]*")


def read_bindings(path: Path | str, known: Vocabulary | None = None) -> Bindings:
    """Read a bindings file, its names checked against the known ones if given; raise `InputError` where something is wrong."""
    return bindings_in(load_yaml(path), known)


def bindings_in(top: Mapped, known: Vocabulary | None = None, *, strangers: bool = False) -> Bindings:
    """Return the bindings of a file that is loaded, as `read_bindings` does.

    Args:
        top: what is in the file.
        known: the declared names.
        strangers: whether there may be bindings of actions that are not declared.
    """
    top.only("actions", "assumed", "lag")
    for key, where, node in top.section("actions").entries():
        if key in binding_keys("type") and not (node.is_mapping or node.is_null):
            raise InputError(f"{key!r} belongs under an action: two more spaces before it", where)
    entries = top.mapping("actions")
    actions: dict[str, Binding] = {}
    for name, entry in entries.items():
        entry.only(*binding_keys("type"))
        actions[name] = read_binding(entry)
    if known is not None:
        for name, entry in entries.items():
            if strangers and name not in known.actions:
                continue
            known.check_action(name, entry.start)
            for parameter in placeholders(actions[name].server or ""):
                known.check_parameter(name, parameter, entry.position("server"))
            for pattern, position in _read_resources(entry):
                for parameter in placeholders(pattern):
                    known.check_parameter(name, parameter, position)
            if (goal := entry.filled("goal")) is not None:
                _check_sources(goal, name, known)
        for name in () if strangers else top.strings("assumed"):
            known.check_set(name, top.position("assumed"))
    return Bindings(actions, frozenset(top.strings("assumed")), top.number("lag", 1.0))


def binding_keys(type_key: str) -> tuple[str, ...]:
    """Return the keys of a binding, in files in which the type of the ROS action stands under `type_key`."""
    return tuple(type_key if field.name == "type" else field.name for field in fields(Binding) if field.compare)


def read_binding(entry: Mapped, *, type_key: str = "type", retries: int = DEFAULT.retries) -> Binding:
    """Read the binding of one action; other keys of the entry are ignored.

    The type of the ROS action stands under `type_key`; `retries` is the number of an action that gives none.
    """
    goal, success, reason, final = map(entry.filled, ("goal", "success", "reason", "final"))
    if goal is not None and not goal.is_mapping:
        raise goal.wrong("expected goal fields and their values")
    server = entry.string("server")
    if server is not None:
        check_pattern(server, entry.position("server"), "/{robot}/navigate")
        if _SERVER.fullmatch(server) is None:
            raise InputError(f"{server!r} cannot name an action server; expected letters, digits, _ and /", entry.position("server"))
    action_type = entry.string(type_key)
    if action_type is not None and _TYPE.fullmatch(action_type) is None:
        example = "nav2_msgs/action/NavigateToPose"
        raise InputError(f"expected a type such as {example} under {type_key!r}, found {action_type!r}", entry.position(type_key))
    return Binding(
        server=server,
        several_servers=entry.flag("several_servers"),
        type=action_type,
        goal=None if goal is None else {name: _source(part) for name, _, part in goal.mapped().entries()},
        success=None if success is None else field_test(success),
        reason=None if reason is None else field_value(reason),
        final=None if final is None else field_test(final),
        store=read_texts(entry, "store", "expected result fields and the variables to store them in"),
        timeout=entry.number("timeout", None),
        accept=entry.number("accept", DEFAULT.accept),
        cancel=entry.number("cancel", DEFAULT.cancel),
        retries=entry.whole("retries", retries),
        ask=read_texts(entry, "ask", "expected variables, and what a person is asked when nobody knows them"),
        resources=tuple(dict.fromkeys(name for name, _ in _read_resources(entry))),
        foreign=entry.choice("foreign", Foreign),
        when_lost=entry.choice("when_lost", WhenLost) or DEFAULT.when_lost,
        position=entry.start,
    )


def _source(node: Node) -> object:
    """Return what a goal field is filled from; it may be inside of others."""
    if (parts := _table(node)) is not None:
        of, rows = parts
        return Table(_source(of), {name: _source(row) for name, _, row in rows.entries()})
    if node.is_mapping:
        return {name: _source(part) for name, _, part in node.mapped().entries()}
    if node.items is not None:
        return [_source(item) for item in node.items]
    if node.text is not None and node.text.startswith("("):
        try:
            parse_fluent(node.text)
        except InputError as error:
            raise node.wrong(error.message) from error
    return node.plain()


def _table(node: Node) -> tuple[Node, Mapped] | None:
    """Return what a table looks at, and its rows; None for anything else."""
    if not node.is_mapping or node.mapped().nodes.keys() != {"of", "table"}:
        return None
    of, rows = node.mapped().needed("of"), node.mapped().needed("table")
    if (of.text or "")[:1] not in ("?", "$", "("):
        raise of.wrong("expected a parameter such as ?to, a variable such as $place, or a function such as (home ?robot)")
    if not rows.is_mapping or not rows.mapped().nodes:
        raise rows.wrong(f"expected values of {of.text} and what they mean for the field")
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


def _read_resources(entry: Mapped) -> Iterator[tuple[str, Position]]:
    names, node = entry.strings("resources"), entry.node("resources")
    items = (node.items if node else None) or ()
    for name, item in zip(names, items, strict=True):
        check_pattern(name, item.position, "{robot}/base")
        yield name, item.position


def read_texts(entry: Mapped, key: str, expected: str) -> dict[str, str]:
    """Read a mapping of names to texts; empty when the key is not there."""
    texts = entry.plain(key)
    if texts is not None and not (isinstance(texts, dict) and all(isinstance(text, str) for text in texts.values())):
        raise InputError(expected, entry.position(key))
    return texts or {}


def check_pattern(pattern: str, position: Position, example: str, parameters: Collection[str] | None = None) -> None:
    """Refuse the pattern of a name that has in braces what is no parameter: none of these, or, without them, not even a name."""
    try:
        names = [*placeholders(pattern)]
        wrong = [f"{{{name}}} is no parameter" for name in names if not (_NAME.match(name) if parameters is None else name in parameters)]
    except ValueError as error:
        wrong = [str(error)]
    if wrong:
        raise InputError(f"{wrong[0]} in {pattern!r}; expected something like {example}", position)
