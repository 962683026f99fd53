"""Steps of plans: from YAML to the syntax tree of a plan, checked against the known actions.

What is done when a call fails stands in the tree as it is written: ``before``, ``during`` and ``after``, each with chains of steps. A
chain is a list of steps that ends in a command. In its long form, ``{when: condition, do: chain, times: n}``, it has a condition of its
own and a limit of how often it may be used; there may be a list of these.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import inf
from typing import Final, TypeAlias, assert_never

from pnm.actions.bindings_file import check_pattern
from pnm.core.logic.computed_values import Data, KnowledgeOperation
from pnm.core.logic.conditions import Condition
from pnm.core.logic.domain import ProblemModel
from pnm.core.machine.failure_causes import Cause, Phase, causes_in
from pnm.core.machine.plan_graph import Choice, Loop, Moment, Step, Then, WaitUntil
from pnm.errors import InputError, Position, Tolerated
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language import grammar
from pnm.language.domain import OPERATION, LanguageAction, check_stored
from pnm.language.formulas.readers import read_condition
from pnm.language.formulas.scope import FormulaScope, known_names, shown, unknown
from pnm.language.formulas.words import read_data, read_operation


@dataclass(frozen=True, slots=True)
class Wait:
    """A condition for a step: the end, or the start, of another step of the same list."""

    id: str
    position: Position
    moment: Moment = Moment.END
    delay: float = 0.0
    """Seconds that must pass besides."""


@dataclass(frozen=True, slots=True)
class StepPlacement:
    """The position of a step."""

    position: Position
    id: str | None = None
    after: tuple[Wait, ...] | None = None
    """The conditions for its start; None for the step before it."""
    end_after: tuple[Wait, ...] = ()
    """The conditions for its end: only a call has one that can wait."""


@dataclass(frozen=True, slots=True)
class GivenValue:
    """The value that a step gives a parameter."""

    data: Data
    position: Position


@dataclass(frozen=True, slots=True)
class WrittenRecovery:
    """The reactions to some causes of failure."""

    position: Position
    causes: frozenset[Cause]
    chain: StepList
    then: Then
    times: int | None = None
    """None if the file gives no number."""
    when: Condition | None = None
    """For checks of its own, before or after."""


@dataclass(frozen=True)
class CallStep:
    """An action is called."""

    place: StepPlacement
    action: LanguageAction
    given: Mapping[str, GivenValue] = field(default_factory=dict)
    """By parameter, without ``?``."""
    operation: KnowledgeOperation | None = None
    recoveries: tuple[WrittenRecovery, ...] | None = None
    """In place of those of the action; None if the step has none of its own."""
    retries: int | None = None
    timeout: float | None = None
    duration: float | None = None
    """Chosen within the bounds that the action gives."""
    release: float = 0.0
    """Seconds after the beginning of the plan before which it must not start."""
    latest_start: float = inf
    """Seconds after the beginning of the plan by which it must have been sent."""
    deadline: float = inf
    """Seconds after the beginning of the plan by which it must have ended."""
    resources: tuple[str, ...] = ()
    """Besides those of the action."""
    store: Mapping[str, str] = field(default_factory=dict)
    outcome: str = ""
    """The name of the expected one; the first by default."""


@dataclass(frozen=True, slots=True)
class StepList:
    """Steps one after the other, at the same time, or in the partial order that their ``after`` gives."""

    place: StepPlacement
    steps: tuple[WrittenStep, ...]
    is_concurrent: bool = False


@dataclass(frozen=True, slots=True)
class BlockStep:
    """A step that is no call and has a condition: a loop, a choice, or a wait."""

    place: StepPlacement
    condition: Condition
    held: tuple[StepList, ...]
    made: Callable[..., Step]
    """Makes the step of the graph of a number, the condition and the flows of what it holds."""


WrittenStep: TypeAlias = CallStep | StepList | BlockStep

_DURING: Final = {"preempted" if cause is Cause.CANCELED else cause.value: cause for cause in Cause if cause.phase is Phase.DURING}
_OPTIONS: Final = tuple(grammar.Call.known)
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

    def steps(self, node: Node) -> StepList:
        """Read a list of steps."""
        if node.items is None and not node.is_null:
            raise node.wrong(f"expected a list of steps, found {shown(node)}{'; each begins with a dash and a space' * node.is_mapping}")
        return self.sequence(node.items or (), node.position)

    def sequence(self, nodes: tuple[Node, ...], position: Position) -> StepList:
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
        return StepList(StepPlacement(position), steps)

    def step(self, node: Node) -> WrittenStep:
        """Read one step; a list of steps is a sequence."""
        if node.items is not None:
            return self.steps(node)
        if not node.is_mapping:
            hint = f"; write '- {node.text}:'" if node.text else ""
            raise node.wrong(f"expected a step such as '- action: {{parameter: value}}', found {shown(node)}{hint}")
        entry = node.mapped()
        kind = next((kind for word, kind in grammar.BLOCKS.items() if word in entry.nodes), None)
        if kind is None:
            return self._call(self._head(entry), grammar.Call(entry))
        if kind is grammar.If:
            within = entry.needed("if").mapped().nodes if entry.needed("if").is_mapping else {}
            for key in [key for key in ("condition", "then", "else") if key in within]:
                how = "'if' has the condition itself, without this word" if key == "condition" else "it stands beside 'if'"
                raise InputError(f"{key!r} does not belong under 'if': {how}", within[key][0])
        block = kind(entry)
        place = _place(block)
        match block:
            case grammar.Concurrent() | grammar.InSequence():
                return StepList(place, self.steps(block.steps).steps, isinstance(block, grammar.Concurrent))
            case grammar.While():
                loop, body = block.loop, self.steps(block.loop.actions)
                if not body.steps:
                    raise InputError("a loop repeats at least one step", loop.entry.position("actions"))
                return BlockStep(place, read_condition(loop.condition, self.scope), (body,), partial(Loop, limit=loop.limit))
            case grammar.Waiting():
                return BlockStep(place, read_condition(block.wait.condition, self.scope), (), partial(WaitUntil, limit=block.wait.limit))
            case grammar.If():
                otherwise = StepList(StepPlacement(entry.start), ()) if block.else_ is None else self.steps(block.else_)
                return BlockStep(place, read_condition(block.if_, self.scope), (self.steps(block.then), otherwise), Choice)
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

    # --- calls ---

    def _call(self, name: str, written: grammar.Call) -> CallStep:
        entry = written.entry
        if name not in self.actions:
            where, word = entry.nodes[name][0], name.partition("{")[0].strip(": ")
            if word in self.actions:
                raise InputError(f"expected ': ' after {word!r}, found {name!r}", where)
            if any(action.kind is not grammar.ActionKind.PLAN for action in self.actions.values()):
                raise unknown("action", name, self.actions.keys() | grammar.RESERVED - {"then", "else"}, where)
            raise InputError(f"there is no domain that would have an action {name!r}; expected 'actions', or 'domain' and a file", where)
        action = self.actions[name]
        argument = entry.needed(name)
        if not (argument.is_null or argument.is_mapping):
            first = next(iter(action.schema.names), "" if not action.is_open else "parameter")
            write = f"- {name}: {{{first}: {argument.written or '…'}}}" if first else f"- {name}:"
            raise argument.wrong(f"expected the parameters of {name}, found {shown(argument)}; write '{write}'")
        arguments = Mapped(entry.file, entry.start, {}) if argument.is_null else argument.mapped()
        entries = [entry for entry in arguments.entries() if action.kind is not grammar.ActionKind.KB or entry[0] != OPERATION]
        given = {key: self._given(action, key, where, node) for key, where, node in entries}
        options = grammar.Call(entry.without(name))  # the action may have the name of an option
        resources = tuple(options.resources)
        if action.kind is not grammar.ActionKind.KB:
            names = given if action.is_open else action.schema.names
            example = next((f"{{{parameter}}}/base" for parameter in names), "base")
            for pattern in (action.binding.server or "", *action.resources, *resources):
                check_pattern(
                    pattern, options.entry.position("resources") if pattern in resources else entry.nodes[name][0], example, names
                )
        inner = replace(self.scope, variables=None if action.is_open else {}).inside(action.schema.parameters)
        check_stored(options.store, options.entry, inner)
        return CallStep(
            _place(options),
            action,
            given,
            operation=self._operation(action, arguments) if action.kind is grammar.ActionKind.KB else None,
            recoveries=None if options.recoveries is None else self.recoveries(action, options.recoveries),
            retries=options.retries,
            timeout=options.timeout,
            duration=options.duration,
            release=options.release,
            latest_start=options.latest_start,
            deadline=options.deadline,
            resources=resources,
            store=options.store,
            outcome=options.outcome or "",
        )

    def recoveries(self, action: LanguageAction, node: Node) -> tuple[WrittenRecovery, ...]:
        """Read the reactions to failures of the action's calls: ``before``, ``during`` and ``after``."""
        if node.is_null:
            return ()
        keys = grammar.RecoveryKeys(node.mapped())
        inner = StepReader(self.actions, self.declared, frozenset(variable.name for variable in action.schema.parameters))
        recoveries = inner._recoveries(keys.before, causes_in(Phase.BEFORE), Cause.BEFORE)
        for outcome, _, chains in keys.during.entry.entries():
            recoveries += inner._recoveries(chains, frozenset({_DURING[outcome]}), None)
        recoveries += inner._recoveries(keys.after, causes_in(Phase.AFTER), Cause.AFTER)
        always = dict[Cause, Then]()
        for recovery in recoveries:
            if recovery.causes <= always.keys():
                before = always[next(iter(recovery.causes))].value
                message = f"this can never happen: the recovery before it ends with {before}, and is always possible"
                raise InputError(message, recovery.position)
            if recovery.when is None and recovery.then.is_last(chain=bool(recovery.chain.steps)):
                always |= dict.fromkeys(recovery.causes, recovery.then)
        return tuple(recoveries)

    def _recoveries(self, node: Node | None, usual: frozenset[Cause], own: Cause | None) -> list[WrittenRecovery]:
        """Read the recoveries of a list of long forms, or the only one."""
        if node is None or node.is_null:
            return []
        chains = node.items if node.items and all(map(_is_long, node.items)) else (node,)
        return [self._recovery(chain, usual, own) for chain in chains]

    def _recovery(self, node: Node, usual: frozenset[Cause], own: Cause | None) -> WrittenRecovery:
        keys = (grammar.Chain if own is None else grammar.ConditionalChain)(node.mapped()) if _is_long(node) else None
        when: Condition | None = None
        if isinstance(keys, grammar.ConditionalChain) and keys.when is not None:
            when = read_condition(keys.when, self.scope)
        times = None if keys is None else keys.times
        causes = usual if when is None or own is None else frozenset({own})
        whole = node if keys is None else keys.do
        items = whole.each
        if not items or items[-1].text is None:
            raise (items[-1] if items else whole).wrong(f"expected a command at the end of the chain: {', '.join(grammar.COMMANDS)}")
        *steps, command = items
        if command.text not in grammar.COMMANDS:
            raise unknown("command", command.text or "", grammar.COMMANDS, command.position)
        for step in steps:
            if step.text in grammar.COMMANDS:
                raise step.wrong(f"{step.text} ends the chain; nothing may come after it")
        chain, then = self.sequence(tuple(steps), whole.position), grammar.COMMANDS[command.text]
        if then is Then.CONTINUE and not causes <= causes_in(Phase.DURING):
            raise node.wrong("only a call whose request has ended can continue; expected another command, such as skip_action")
        return WrittenRecovery(node.position, causes, chain, then, times, when)

    def _given(self, action: LanguageAction, key: str, where: Position, node: Node) -> GivenValue:
        parameters = action.schema.names
        if not action.is_open and key not in parameters:
            raise InputError(f"{action.name} has no parameter {key!r}; {known_names(key, parameters)}", where)
        data = read_data(node, self.scope)
        if f"?{key}" not in action.objects or node.is_mapping:
            return GivenValue(data, node.position)
        # refuse what cannot be the name of an object, such as an ``on`` without quotes, and objects that are not there
        value, name, declared = node.plain(), node.written, self.declared
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            hint = f"; write {name!r} with quotes" if name else ""
            raise node.wrong(f"{key} of {action.name} is the name of an object, not {shown(node)}{hint}")
        if not name.startswith(("?", "(")) and declared.objects:
            types = next(variable.types for variable in action.schema.parameters if variable.name == f"?{key}")
            if declared.all_types(declared.objects.get(name, ())).isdisjoint(types):
                fitting = {fit for kind in types for fit in declared.objects_by_type.get(kind, ())}
                raise unknown(f"object for {key} of {action.name} (one of type {' or '.join(types)})", name, fitting, node.position)
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


def _place(keys: grammar.Place) -> StepPlacement:
    end_after = _waits(keys.end_after) if isinstance(keys, grammar.Call) else None
    return StepPlacement(keys.entry.start, keys.id, _waits(keys.after), end_after or ())


def _is_long(node: Node) -> bool:
    return node.is_mapping and "do" in node.mapped().nodes


def _waits(node: Node | None) -> tuple[Wait, ...] | None:
    """Read ids of steps, each as it stands, or as ``{start: id}`` or ``{end: id, delay: seconds}``."""
    if node is None:
        return None
    waits: list[Wait] = []
    for item in node.each:
        if item.text is not None:
            waits.append(Wait(item.text, item.position))
            continue
        if not item.is_mapping:
            raise item.wrong(f"expected the id of a step, found {shown(item)}")
        keys = grammar.WaitFor(item.mapped())
        named = [(moment, name) for moment, name in ((Moment.START, keys.start), (Moment.END, keys.end)) if name is not None]
        if len(named) != 1:
            raise InputError("expected either 'start' or 'end' and the id of a step", keys.entry.start)
        ((moment, name),) = named
        waits.append(Wait(name, keys.entry.position(moment.value), moment, keys.delay))
    return tuple(waits)
