"""Steps of plans: from YAML to `pnm.language.plan_tree`, checked against the known actions."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, assert_never

from pnm.actions.bindings_file import check_pattern
from pnm.core.logic.computed_values import KnowledgeOperation
from pnm.core.logic.domain import ProblemModel
from pnm.core.machine.plan_graph import Moment, WaitUntil
from pnm.errors import InputError, Position, Tolerated
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language.actions import OPERATION, LanguageAction
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import FormulaScope, known_names, shown, unknown
from pnm.language.formulas.values import read_data, read_operation
from pnm.language.grammar import BLOCKS, RESERVED, ActionKind, Call, Concurrent, If, InSequence, LoopKeys, Place, WaitFor, Waiting, While
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

_OPTIONS: Final = tuple(Call.known)
"""The keys of a step beside the one that names its action or block."""
_INSERTED: Final = re.compile(r"\$\{(?P<first>[A-Za-z_]\w*)\}|\$(?P<second>[A-Za-z_]\w*)|\{(?P<third>[A-Za-z_]\w*)\}")
"""The notation of other languages for the value of a variable inside of a text."""


@dataclass(frozen=True)
class StepReader:
    """Reads steps where these actions and names are known."""

    actions: Mapping[str, LanguageAction]
    declared: ProblemModel
    variables: frozenset[str] = frozenset()
    """In a chain of recovery, the parameters of the call that recovers."""

    @cached_property
    def scope(self) -> FormulaScope:
        """The names that values and conditions may use."""
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
        kind = next((kind for word, kind in BLOCKS.items() if word in entry.nodes), None)
        if kind is None:
            return self._call(self._head(entry), Call(entry))
        if kind is If:
            _check_condition(entry)
        block = kind(entry)
        place = _place(block)
        match block:
            case Concurrent():
                return ConcurrentStep(place, self.steps(block.steps).steps)
            case InSequence():
                return SequenceStep(place, self.steps(block.steps).steps)
            case While():
                return self._loop(block.loop, place)
            case Waiting():
                return LeafStep(place, WaitUntil(0, read_condition(block.wait.condition, self.scope), block.wait.limit))
            case If():
                otherwise = SequenceStep(StepPlacement(entry.start), ()) if block.else_ is None else self.steps(block.else_)
                return ChoiceStep(place, read_condition(block.if_, self.scope), self.steps(block.then), otherwise)
            case _:
                assert_never(block)

    def _head(self, entry: Mapped) -> str:
        """Return the key that names the action of a call."""
        heads = [key for key in entry.nodes if key not in _OPTIONS] or [key for key in entry.nodes if key in self.actions]
        if len(heads) == 1:
            return heads[0]
        if not heads:
            raise InputError(f"the step does nothing; expected an action beside {', '.join(entry.nodes) or 'nothing'}", entry.start)
        strange = next((head for head in heads if head not in self.actions), heads[1])
        message = f"a step does one thing; {strange!r} is a second one, and none of the options: {', '.join(_OPTIONS)}"
        raise InputError(message, entry.nodes[strange][0])

    def _loop(self, loop: LoopKeys, place: StepPlacement) -> LoopStep:
        body = self.steps(loop.actions)
        if not body.steps:
            raise InputError("a loop repeats at least one step", loop.entry.position("actions"))
        return LoopStep(place, read_condition(loop.condition, self.scope), body, loop.limit)

    # --- calls ---

    def _call(self, name: str, written: Call) -> CallStep:
        entry = written.entry
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
        options = Call(entry.without(name))  # the action may have the name of an option
        resources = tuple(options.resources)
        if action.kind is not ActionKind.KB:
            names = given if action.is_open else [variable.name[1:] for variable in action.schema.parameters]
            example = next((f"{{{parameter}}}/base" for parameter in names), "base")
            for pattern in (action.binding.server or "", *action.resources, *resources):
                check_pattern(
                    pattern, options.entry.position("resources") if pattern in resources else entry.nodes[name][0], example, names
                )
        return CallStep(
            _place(options),
            action,
            given,
            operation=self._operation(action, arguments) if action.kind is ActionKind.KB else None,
            recoveries=None if options.recoveries is None else self.recoveries(action, options.recoveries),
            retries=options.retries,
            timeout=options.timeout,
            duration=options.duration,
            release=options.release,
            latest_start=options.latest_start,
            deadline=options.deadline,
            resources=resources,
            store=options.store,
        )

    def recoveries(self, action: LanguageAction, node: Node) -> tuple[WrittenRecovery, ...]:
        """Read the reactions to failures of the action's calls."""
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


def _place(keys: Place) -> StepPlacement:
    end_after = _waits(keys.end_after) if isinstance(keys, Call) else None
    return StepPlacement(keys.entry.start, keys.id, _waits(keys.after), end_after or ())


def _check_condition(entry: Mapped) -> None:
    """Refuse keys under ``if`` that belong beside it."""
    within = entry.needed("if").mapped().nodes if entry.needed("if").is_mapping else {}
    for key in [key for key in ("condition", "then", "else") if key in within]:
        how = "'if' has the condition itself, without this word" if key == "condition" else "it stands beside 'if'"
        raise InputError(f"{key!r} does not belong under 'if': {how}", within[key][0])


def _waits(node: Node | None) -> tuple[Wait, ...] | None:
    return None if node is None else tuple(map(_wait, (node,) if node.items is None else node.items))


def _wait(node: Node) -> Wait:
    """Read the id of a step, or ``{start: id}`` or ``{end: id, delay: seconds}``."""
    if node.text is not None:
        return Wait(node.text, node.position)
    if not node.is_mapping:
        raise node.wrong(f"expected the id of a step, found {shown(node)}")
    keys = WaitFor(node.mapped())
    named = [(moment, name) for moment, name in ((Moment.START, keys.start), (Moment.END, keys.end)) if name is not None]
    if len(named) != 1:
        raise InputError("expected either 'start' or 'end' and the id of a step", keys.entry.start)
    ((moment, name),) = named
    return Wait(name, keys.entry.position(moment.value), moment, keys.delay)
