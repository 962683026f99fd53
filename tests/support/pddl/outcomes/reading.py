"""PDDL as lists of words, and the domain that a planner without outcomes is asked about."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import product
from typing import Any, Final, TypeAlias

Node: TypeAlias = Any
"""A word, or a list of nodes."""
Atom: TypeAlias = tuple[str, ...]
Env: TypeAlias = Mapping[str, str]

OUTCOMES: Final = (":non-deterministic", ":probabilistic-effects")


def parse(text: str) -> Node:
    """Read one list of words and lists."""
    stack: list[list[Node]] = [[]]
    for word in re.findall(r"[()]|[^\s()]+", re.sub(r";.*", "", text).lower()):
        if word == "(":
            stack.append([])
        elif word == ")":
            stack[-2].append(stack.pop())
        else:
            stack[-1].append(word)
    return stack[0][0]


def text_of(node: Node) -> str:
    """Return the text of a node."""
    return node if isinstance(node, str) else f"({' '.join(map(text_of, node))})"


def typed(words: Iterable[Node]) -> list[tuple[str, tuple[str, ...]]]:
    """Return the names of a typed list with their types."""
    found: list[tuple[str, tuple[str, ...]]] = []
    names: list[str] = []
    after = False
    for word in words:
        if after:
            types = tuple(word[1:]) if isinstance(word, list) else (word,)
            found.extend((name, types) for name in names)
            names, after = [], False
        elif word == "-":
            after = True
        else:
            names.append(word)
    return found + [(name, ("object",)) for name in names]


def heads(node: Node) -> Iterator[str]:
    """Yield the names at the heads of all lists in a node."""
    if isinstance(node, list) and node:
        if isinstance(node[0], str):
            yield node[0]
        for part in node:
            yield from heads(part)


def conjuncts(node: Node) -> list[Node]:
    """Return the parts of a conjunction."""
    return [part for each in node[1:] for part in conjuncts(each)] if node and node[0] == "and" else [node] if node else []


def bound(node: Node, env: Env) -> Atom:
    """Return a list of words with the objects of its variables."""
    return tuple([env.get(word, word) for word in node])


def determinized(domain: Node) -> str:
    """Return a domain with an action for each outcome: its name, two underscores and a number."""
    sections: list[Node] = []
    for section in domain:
        head = section[0] if isinstance(section, list) else ""
        if head == ":action" and ":effect" in section:
            at = section.index(":effect") + 1
            for number, effect in enumerate(_branches(section[at])):
                sections.append([head, f"{section[1]}__{number}", *section[2:at], effect, *section[at + 1 :]])
        else:
            sections.append([word for word in section if word not in OUTCOMES] if head == ":requirements" else section)
    return text_of(sections)


def _branches(node: Node) -> list[Node]:
    """Return the effects that an effect may turn out to be, without their chances; `forall` is left as it is."""
    match node:
        case ["and", *parts]:
            return [["and", *chosen] for chosen in product(*map(_branches, parts))]
        case ["when", condition, part]:
            return [["when", condition, branch] for branch in _branches(part)]
        case ["probabilistic", *parts]:
            return _branches(["oneof", *parts[1::2], *([["and"]] if sum(map(Fraction, parts[::2])) < 1 else [])])
        case ["oneof", *parts]:
            found = [branch for part in parts for branch in _branches(part)]
            return [branch for number, branch in enumerate(found) if branch not in found[:number]]
        case _:
            return [node]
