"""Steps of plans: from YAML to `pnm.language.plan_tree`, checked against the known actions."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Final

from pnm.actions.bindings_file import check_pattern, read_texts
from pnm.core.logic.computed_values import KnowledgeOperation
from pnm.core.logic.domain import ProblemModel
from pnm.core.machine.plan_graph import Moment, WaitUntil
from pnm.errors import InputError, Position, Tolerated
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language.actions import OPERATION, RESERVED, ActionKind, LanguageAction
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import FormulaScope, known_names, shown, unknown
from pnm.language.formulas.values import read_data, read_operation
from pnm.language.plan_tree import (
    CallStep,
    ChoiceStep,
    ConcurrentStep,
    GivenValue,
    LeafStep,
    LoopStep,
    SequenceStep,
    StepPlacement,
    Wait,
    WrittenRecovery,
    WrittenStep,
    read_recoveries,
)

DEFAULT_LIMIT: Final = 1000
"""How often a loop is repeated at most, without a limit in the plan."""
MAX_LIMIT: Final = 1_000_000
_PLACE: Final = ("id", "after")
_CALL: Final = ("recoveries", "retries", "timeout", "resources", "store", "end_after", "duration", "release", "latest_start", "deadline")
OPTIONS: Final = (*_PLACE, *_CALL)
"""The keys of a step beside the one that names its action or block."""
_INSERTED: Final = re.compile(r"\$\{(?P<first>[A-Za-z_]\w*)\}|\$(?P<second>[A-Za-z_]\w*)|\{(?P<third>[A-Za-z_]\w*)\}")
"""How other languages write the value of a variable inside of a text."""


@dataclass(frozen=True)
class StepReader:
    """Reads steps where these actions and names are known."""

    actions: Mapping[str, LanguageAction]
    declared: ProblemModel
    variables: frozenset[str] = frozenset()
    """In a chain of recovery, the parameters of the call that recovers."""

    @cached_property
    def scope(self) -> FormulaScope:
        """What values and conditions may use."""
        return FormulaScope(self.declared, dict.fromkeys(self.variables, ("object",)))

    def steps(self, node: Node) -> SequenceStep:
        """Read a list of steps."""
        if node.items is None and not node.is_null:
            raise node.wrong(f"expected a list of steps, found {shown(node)}{'; each begins with a dash and a space' * node.is_mapping}")
        return self.sequence(node.items or (), node.position)

    def sequence(self, nodes: tuple[Node, ...], position: Position) -> SequenceStep:
        """Read steps that follow each other."""
        steps = tuple([self.step(node) for node in nodes])
        known: set[str] = set()
        for step in steps:
            if step.place.id is not None and step.place.id in known:
                raise InputError(f"the id {step.place.id!r} is there twice", step.place.position)
            known |= {step.place.id} if step.place.id is not None else set()
        for wait in [wait for step in steps for wait in (*(step.place.after or ()), *step.place.end_after)]:
            if wait.id not in known:
                raise unknown("step with the id", wait.id, known, wait.position)
        return SequenceStep(StepPlacement(position), steps)

    def step(self, node: Node) -> WrittenStep:
        """Read one step; a list of steps is a sequence."""
        if node.items is not None:
            return self.steps(node)
        if not node.is_mapping:
            hint = f"; write '- {node.text}:'" if node.text else ""
            raise node.wrong(f"expected a step such as '- action: {{parameter: value}}', found {shown(node)}{hint}")
        entry = node.mapped()
        head = self._head(entry)
        options = entry.without(head)
        after, end_after = _waits(options.node("after")), _waits(options.node("end_after"))
        place = StepPlacement(entry.start, options.string("id"), after, end_after or ())
        match head:
            case "concurrent_actions":
                entry.only("concurrent_actions", *_PLACE)
                return ConcurrentStep(place, self.steps(entry.needed("concurrent_actions")).steps)
            case "sequence":
                entry.only("sequence", *_PLACE)
                return SequenceStep(place, self.steps(entry.needed("sequence")).steps)
            case "while":
                for key in [key for key in entry.nodes if key in ("condition", "actions", "limit")]:
                    raise InputError(f"{key!r} belongs under 'while': two more spaces before it", entry.nodes[key][0])
                entry.only("while", *_PLACE)
                return self._loop(entry.needed("while").mapped(), place)
            case "wait_until":
                entry.only("wait_until", *_PLACE)
                return LeafStep(place, self._wait_until(entry.needed("wait_until").mapped()))
            case "if":
                entry.only("if", "then", "else", *_PLACE)
                within = entry.needed("if").mapped().nodes if entry.needed("if").is_mapping else {}
                for key in [key for key in ("condition", "then", "else") if key in within]:
                    how = "'if' has the condition itself, without this word" if key == "condition" else "it stands beside 'if'"
                    raise InputError(f"{key!r} does not belong under 'if': {how}", within[key][0])
                condition = read_condition(entry.needed("if"), self.scope)
                then = self.steps(entry.needed("then"))
                return ChoiceStep(
                    place,
                    condition,
                    then,
                    self.steps(entry.needed("else")) if "else" in entry.nodes else SequenceStep(StepPlacement(entry.start), ()),
                )
            case name:
                entry.only(name, *OPTIONS)
                return self._call(name, entry, place)

    def _head(self, entry: Mapped) -> str:
        """Return the key that names the action or the block of the step."""
        for word in ("if", "while", "wait_until", "concurrent_actions", "sequence"):
            if word in entry.nodes:
                return word
        heads = [key for key in entry.nodes if key not in OPTIONS] or [key for key in entry.nodes if key in self.actions]
        if len(heads) == 1:
            return heads[0]
        if not heads:
            raise InputError(f"the step does nothing; expected an action beside {', '.join(entry.nodes) or 'nothing'}", entry.start)
        strange = next((head for head in heads if head not in self.actions), heads[1])
        message = f"a step does one thing; {strange!r} is a second one, and none of the options: {', '.join(OPTIONS)}"
        raise InputError(message, entry.nodes[strange][0])

    def _loop(self, entry: Mapped, place: StepPlacement) -> LoopStep:
        entry.only("condition", "actions", "limit")
        limit = entry.whole("limit", DEFAULT_LIMIT)
        if not 1 <= limit <= MAX_LIMIT:
            raise InputError(f"expected a limit from 1 to {MAX_LIMIT}, found {limit}", entry.position("limit"))
        body = self.steps(entry.needed("actions"))
        if not body.steps:
            raise InputError("a loop repeats at least one step", entry.position("actions"))
        return LoopStep(place, read_condition(entry.needed("condition"), self.scope), body, limit)

    def _wait_until(self, entry: Mapped) -> WaitUntil:
        entry.only("condition", "limit")
        entry.needed("limit")  # nobody waits for ever
        return WaitUntil(0, read_condition(entry.needed("condition"), self.scope), entry.number("limit", 0.0))

    # --- calls ---

    def _call(self, name: str, entry: Mapped, place: StepPlacement) -> CallStep:
        if name not in self.actions:
            where, word = entry.nodes[name][0], name.partition("{")[0].strip(": ")
            if word in self.actions:
                raise InputError(f"expected ': ' after {word!r}, found {name!r}", where)
            if any(action.kind is not ActionKind.PLAN for action in self.actions.values()):
                raise unknown("action", name, self.actions.keys() | RESERVED - {"then", "else"}, where)
            raise InputError(f"there is no domain that would have an action {name!r}; expected 'actions', or 'domain' and a file", where)
        action = self.actions[name]
        argument = entry.needed(name)
        if not (argument.is_null or argument.is_mapping):
            first = next((variable.name[1:] for variable in action.schema.parameters), "" if not action.is_open else "parameter")
            write = f"- {name}: {{{first}: {argument.written or '…'}}}" if first else f"- {name}:"
            raise argument.wrong(f"expected the parameters of {name}, found {shown(argument)}; write '{write}'")
        arguments = Mapped(entry.file, entry.start, {}) if argument.is_null else argument.mapped()
        entries = [entry for entry in arguments.entries() if action.kind is not ActionKind.KB or entry[0] != OPERATION]
        given = {key: self._given(action, key, where, node) for key, where, node in entries}
        options = entry.without(name)
        resources = tuple(options.strings("resources"))
        if action.kind is not ActionKind.KB:
            names = given if action.is_open else [variable.name[1:] for variable in action.schema.parameters]
            example = next((f"{{{parameter}}}/base" for parameter in names), "base")
            for pattern in (action.binding.server or "", *action.resources, *resources):
                check_pattern(pattern, options.position("resources") if pattern in resources else entry.nodes[name][0], example, names)
        recoveries = options.node("recoveries")
        return CallStep(
            place,
            action,
            given,
            operation=self._operation(action, arguments) if action.kind is ActionKind.KB else None,
            recoveries=None if recoveries is None else self.recoveries(action, recoveries),
            retries=options.whole("retries", None),
            timeout=options.number("timeout", None),
            duration=options.number("duration", None),
            release=options.number("release", 0.0),
            latest_start=options.number("latest_start", inf),
            deadline=options.number("deadline", inf),
            resources=resources,
            store=read_texts(options, "store", "expected result fields and the variables to store them in"),
        )

    def recoveries(self, action: LanguageAction, node: Node) -> tuple[WrittenRecovery, ...]:
        """Read what is done when calls of the action fail."""
        inner = StepReader(self.actions, self.declared, frozenset(variable.name for variable in action.schema.parameters))
        return read_recoveries(node, inner.scope, inner.sequence)

    def _given(self, action: LanguageAction, key: str, where: Position, node: Node) -> GivenValue:
        parameters = [variable.name[1:] for variable in action.schema.parameters]
        if not action.is_open and key not in parameters:
            raise InputError(f"{action.name} has no parameter {key!r}; {known_names(key, parameters)}", where)
        data = read_data(node, self.scope)
        if f"?{key}" in action.objects:
            _check_object(action, key, node, self.declared)
        return GivenValue(data, node.position)

    def _operation(self, action: LanguageAction, arguments: Mapped) -> KnowledgeOperation:
        node = arguments.node(OPERATION)
        if node is None:
            raise InputError(f"{action.name} works on knowledge; expected the key {OPERATION!r}", arguments.start)
        return read_operation(node, self.scope.inside(action.schema.parameters))


def taken_literally(steps: Node, variables: Collection[str]) -> Iterator[Tolerated]:
    """Yield a warning for what looks like a variable inside of a text, where other languages would put its value."""
    for node in steps.texts("resources"):
        for match in _INSERTED.finditer(node.text or ""):
            name = str(match[match.lastgroup or 0])
            if name in variables or match["first"]:
                value = f"{{LocalQuery: {name}}}"
                how = value if match[0] == node.text else f"{{Operation: [concat, [..., {value}]]}}"
                yield Tolerated(f"{match[0]!r} stays as it is written; for the value of {name} write {how}", node.position)


def _check_object(action: LanguageAction, key: str, node: Node, declared: ProblemModel) -> None:
    """Refuse what cannot be the name of an object, such as an ``on`` without quotes, and objects that are not there."""
    if node.is_mapping:
        return
    value = node.plain()
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        hint = f"; write {node.written!r} with quotes" if node.written else ""
        raise node.wrong(f"{key} of {action.name} is the name of an object, not {shown(node)}{hint}")
    name = node.written
    if name.startswith(("?", "(")) or not declared.objects:
        return
    types = next(variable.types for variable in action.schema.parameters if variable.name == f"?{key}")
    if declared.all_types(declared.objects.get(name, ())).isdisjoint(types):
        fitting = {fit for kind in types for fit in declared.objects_by_type.get(kind, ())}
        raise unknown(f"object for {key} of {action.name} (one of type {' or '.join(types)})", name, fitting, node.position)


def _waits(node: Node | None) -> tuple[Wait, ...] | None:
    return None if node is None else tuple(map(_wait, (node,) if node.items is None else node.items))


def _wait(node: Node) -> Wait:
    """Read the id of a step, or ``{start: id}`` or ``{end: id, delay: seconds}``."""
    if node.text is not None:
        return Wait(node.text, node.position)
    if not node.is_mapping:
        raise node.wrong(f"expected the id of a step, found {shown(node)}")
    entry = node.mapped()
    entry.only("start", "end", "delay")
    named = [(moment, name) for moment in Moment if (name := entry.string(moment.value)) is not None]
    if len(named) != 1:
        raise InputError("expected either 'start' or 'end' and the id of a step", entry.start)
    ((moment, name),) = named
    return Wait(name, entry.position(moment.value), moment, entry.number("delay", 0.0))
