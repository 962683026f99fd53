"""Files of the language: YAML documents, with predefined anchors for the kinds of actions.

Papers print domains without the definitions of their anchors, between ellipses and with damaged indentation: such an
excerpt is mended, with a warning, if it cannot be read as it stands.

Of files with plans, the heads of the plans and the domain are read here, so that plans can call each other.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.expressions import Variable
from pnm.core.machine.bindings import Binding
from pnm.errors import InputError, Position, Tolerated, suggestion
from pnm.files.text import read_text
from pnm.files.yaml_nodes import MAX_BYTES, Mapped, parse_yaml
from pnm.language.domain import CLASSES, LanguageAction, LanguageDomain, domain_from, read_class
from pnm.language.formulas.scope import read_typed, unknown
from pnm.language.grammar import ActionKind, DomainKeys, NamedPlan, PlanKeys, Recipe

ANCHORS: Final = {"base_action": {}, **{kind.value: {"type": kind.value} for kind in CLASSES.values()}}
"""The meanings of ``*ros_action`` and the like in files that do not define them."""
MAX_EXCERPT: Final = 100_000
"""Characters of an excerpt; longer texts are not mended."""
_LONE_KEY: Final = re.compile(r"( *)-( +)[^\s#'\"\[{][^#'\"\[{]*:\s*\Z")


def read_documents(path: Path) -> tuple[tuple[Mapped, ...], tuple[Tolerated, ...]]:
    """Return the documents of a file, and warnings about what was tolerated; raise `InputError` if it is not there, or no YAML mappings."""
    return parse_documents(read_text(path, MAX_BYTES), str(path))


def parse_documents(text: str, file: str) -> tuple[tuple[Mapped, ...], tuple[Tolerated, ...]]:
    """Return the documents of a text, and warnings about what was tolerated in it; raise `InputError` if these are no mappings in YAML."""
    try:
        return parse_yaml(text, file, ANCHORS), ()
    except InputError as error:
        suggestion, changed = _mended(text) if len(text) <= MAX_EXCERPT else (text, [])
        if not changed:
            raise
        try:
            parsed = parse_yaml(suggestion, file, ANCHORS)
        except InputError:
            raise error from None
        return parsed, tuple(Tolerated(message, Position(file, line, 1)) for line, message in changed)


def _mended(text: str) -> tuple[str, list[tuple[int, str]]]:
    """Return the text without a leading ellipsis and with indentation mended, and what was done in which line."""
    lines = text.splitlines()
    changed: list[tuple[int, str]] = []
    first = next((number for number, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), len(lines))
    if first < len(lines) and lines[first].rstrip() == "...":
        lines[first] = ""
        changed.append((first + 1, "'...' at the beginning is left out"))
    for number, line in enumerate(lines):
        match = _LONE_KEY.match(line)
        if match is None or number + 1 == len(lines):
            continue
        dash, key = len(match[1]), len(match[1]) + 1 + len(match[2])
        if dash < _indent(lines[number + 1]) < key:
            changed.append((number + 2, f"indented less than its owner in line {number + 1}"))
            more = " " * (key + 1 - _indent(lines[number + 1]))
            for below in range(number + 1, len(lines)):  # all that belongs to the key
                if lines[below].strip() and _indent(lines[below]) <= dash:
                    break
                lines[below] = more + lines[below]
    return "\n".join(lines) + "\n", changed


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" ")) if line.strip() else 0


_PLAN: Final = tuple(NamedPlan.known)
_DOMAIN: Final = tuple(DomainKeys.known)
_SERVERS: Final = ("ActionServer", "SimpleActionServer", "BasicControllerPluginServer", "DAPluginServer")
"""The classes that files for the original implementation name; every plan becomes a ROS 2 action server."""
_CALLED: Final = Binding(retries=0, timeout=86_400.0, cancel=60.0)
"""The call of a plan by another: its own limits, and those of its calls, end it sooner than these."""


@dataclass(frozen=True)
class PlanHead:
    """The head of a plan, whose steps are not read yet: what other plans need in order to call it."""

    name: str
    keys: PlanKeys
    domain: LanguageDomain
    parameters: tuple[Variable, ...] | None
    warnings: tuple[Tolerated, ...] = ()

    @property
    def action(self) -> LanguageAction:
        """The plan as an action that others call."""
        schema = ActionSchema(self.name, self.parameters or ())
        return LanguageAction(schema, ActionKind.PLAN, self.keys.entry.start, self.parameters is None, binding=_CALLED)


def read_domain(path: Path) -> LanguageDomain:
    """Read the domain of a file, whatever else is in it; raise `InputError` if there is none, or something in it is wrong."""
    documents, warnings = read_documents(path)
    for document in documents:
        _entries(document)
    top = domain_document(documents)
    if top is None:
        raise InputError("there is no domain in the file; expected the key 'actions'", Position(str(path), 1, 1))
    return domain_from(top, warnings)


def plan_heads(path: Path, domain: LanguageDomain | None = None) -> list[PlanHead]:
    """Read the heads of all plans of a file."""
    return plan_heads_in(*read_documents(path), domain)


def plan_heads_in(documents: tuple[Mapped, ...], warnings: tuple[Tolerated, ...], domain: LanguageDomain | None) -> list[PlanHead]:
    """Read the heads of all plans of a file's documents; see `plan_heads`."""
    top = domain_document(documents)
    own = None if top is None else domain_from(top, warnings)
    heads: list[PlanHead] = []
    for document in documents:
        for name, keys in _entries(document):
            if isinstance(keys, Recipe):
                _check_classes(keys)
            entry, path = keys.entry, keys.domain
            parameters = None if keys.params is None else read_typed(keys.params)
            if path is not None and own is not None:
                raise InputError("the file has a domain itself; it cannot name another", entry.position("domain"))
            chosen = own or domain or LanguageDomain() if path is None else read_domain(beside(entry, "domain", path))
            heads.append(PlanHead(name, keys, chosen, parameters, tuple(dict.fromkeys((*warnings, *chosen.warnings)))))
    if not heads:
        raise InputError("there is no plan in the file; expected the key 'plan'", documents[0].start)
    return heads


def _entries(document: Mapped) -> list[tuple[str, PlanKeys]]:
    """Return the plans of a document: itself, or its recipes; refuse whatever else is in it."""
    if "plan" in document.nodes:
        document.only(*_PLAN, *_DOMAIN)
        plan = NamedPlan(document)
        return [(plan.name or Path(document.file).stem, plan)]
    if is_world(document):
        raise InputError("this is a world; expected a plan", document.start)
    recipes: list[tuple[str, PlanKeys]] = []
    for key, where, node in document.entries():
        if key in _DOMAIN:
            continue
        recipe = node.mapped() if node.is_mapping and key not in _PLAN else None
        if recipe is None or recipe.nodes.keys().isdisjoint(Recipe.known):
            if key in _PLAN:
                raise InputError(f"the key 'plan' is missing beside {key!r}", where)
            Mapped(document.file, document.start, {key: document.nodes[key]}).only(*_PLAN, *_DOMAIN)
            continue
        recipes.append((key, Recipe(recipe)))
    return recipes


def is_world(document: Mapped) -> bool:
    """Return whether the document lists the files of plans, or has worlds that do."""
    worlds = (node.mapped() for _, _, node in document.entries() if node.is_mapping)
    return "plan" not in document.nodes and ("plans" in document.nodes or any("recipes" in world.nodes for world in worlds))


def domain_document(documents: Iterable[Mapped]) -> Mapped | None:
    """Return the document that has a domain; None if none has. Raise `InputError` if several have."""
    domains = [document for document in documents if document.nodes.keys() & set(_DOMAIN) - set(_PLAN)]
    if len(domains) > 1:
        raise InputError("there is a domain in this file already", domains[1].start)
    return domains[0] if domains else None


def beside(entry: Mapped, key: str, path: str) -> Path:
    """Return a file that is named relative to the one the entry stands in; raise `InputError` if there is no such file."""
    file = Path(entry.file).parent / path
    if not os.path.isfile(file):  # unlike `Path.is_file` also for names that are too long
        others = sorted(path.name for path in file.parent.glob("*.y*ml")) if os.path.isdir(file.parent) else []
        hint = suggestion(file.name, others)
        raise InputError(f"there is no file {path[:200]!r} beside this one{f'; {hint}' if hint else ''}", entry.position(key))
    return file


def _check_classes(keys: Recipe) -> None:
    """Refuse what the original implementation would import, unless it is what every plan has here."""
    server, message = keys.server, keys.action
    if server is not None:
        _, name = read_class(server)
        if name not in _SERVERS:
            error = unknown("kind of server", name, _SERVERS, server.position)
            raise InputError(f"{error.message}; every plan becomes a ROS 2 action server, so the key may be left out", server.position)
    if message is not None:
        module, _ = read_class(message)
        if not module.endswith(".msg"):
            raise message.wrong(f"{module!r} has no messages; expected a module such as 'rpn_recipe_planner_msgs.msg', or no key 'action'")
