"""Bindings files: which server, goal fields, limits and resources an action has, as YAML."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import fields
from pathlib import Path

from pnm.core.knowledge_base import parse_fluent
from pnm.core.logic.declared_names import Vocabulary
from pnm.core.machine.bindings import _NAME, DEFAULT, Binding, Bindings, placeholders
from pnm.errors import InputError, Position
from pnm.files.yaml_nodes import Mapped, load_yaml, texts_in


def read_bindings(path: Path, known: Vocabulary | None = None) -> Bindings:
    """Read a bindings file, its names checked against the known ones if given; raise `InputError` where something is wrong."""
    top = load_yaml(path)
    top.only("actions", "assumed", "lag")
    entries = top.mapping("actions")
    actions: dict[str, Binding] = {}
    for name, entry in entries.items():
        entry.only(*binding_keys("type"))
        actions[name] = read_binding(entry)
    if known is not None:
        for name, entry in entries.items():
            binding = actions[name]
            known.check_action(name, entry.start)
            for parameter in placeholders(binding.server or ""):
                known.check_parameter(name, parameter, entry.position("server"))
            for pattern, position in _read_resources(entry):
                for parameter in placeholders(pattern):
                    known.check_parameter(name, parameter, position)
            for text in texts_in(binding.goal):  # a parameter, or a fluent with parameters
                for term in parse_fluent(text) if text.startswith("(") else (text,):
                    if term.startswith("?"):
                        known.check_parameter(name, term[1:], entry.position("goal"))
        for name in top.strings("assumed"):
            known.check_set(name, top.position("assumed"))
    return Bindings(actions, frozenset(top.strings("assumed")), top.number("lag", 1.0))


def binding_keys(type_key: str) -> tuple[str, ...]:
    """Return the keys of a binding, in files in which the type of the ROS action stands under `type_key`."""
    return tuple(type_key if field.name == "type" else field.name for field in fields(Binding))


def read_binding(entry: Mapped, *, type_key: str = "type", retries: int = DEFAULT.retries) -> Binding:
    """Read the binding of one action; other keys of the entry are ignored.

    The type of the ROS action stands under `type_key`; `retries` is the number of an action that gives none.
    """
    goal = entry.plain("goal")
    if goal is not None and not isinstance(goal, dict):
        raise InputError("expected goal fields and their values", entry.position("goal"))
    for text in texts_in(goal):
        if text.startswith("("):
            try:
                parse_fluent(text)
            except InputError as error:
                raise InputError(error.message, entry.position("goal")) from error
    server = entry.string("server")
    if server is not None:
        check_pattern(server, entry.position("server"), "/{robot}/navigate")
    return Binding(
        server=server,
        several_servers=entry.flag("several_servers"),
        type=entry.string(type_key),
        goal=goal,
        store=read_texts(entry, "store", "expected result fields and the variables to store them in"),
        timeout=entry.number("timeout", None),
        accept=entry.number("accept", DEFAULT.accept),
        cancel=entry.number("cancel", DEFAULT.cancel),
        retries=entry.whole("retries", retries),
        ask=read_texts(entry, "ask", "expected variables, and what a person is asked when nobody knows them"),
        resources=tuple(dict.fromkeys(name for name, _ in _read_resources(entry))),
    )


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
