"""Domains and problems from YAML files in the language, with the comments in them.

`pnm.language` reads what people and planners share; what only planners need is read here: requirements,
constraints, preferences, metrics, and task networks, which are kept as their HDDL text.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final, Literal

import yaml

from planner_bridge.model.problem import TOTAL_TIME, Domain, Metric, Problem
from planner_bridge.pddl import writer as pddl
from planner_bridge.pddl.comments import Anchor, AnchorPath, Comment, CommentTable, LineIndex, attach
from planner_bridge.pddl.expressions import (
    CONNECTIVES,
    NAME,
    NUMBER,
    TIME_SPECIFIERS,
    Group,
    TimeSpecifier,
    parse as parse_lists,
    with_article,
)
from planner_bridge.pddl.formulas import IS_VIOLATED
from planner_bridge.pddl.reader import HIERARCHY, NETWORK
from planner_bridge.pddl.symbols import CONSTRAINTS
from pnm.actions.bindings_file import read_binding
from pnm.core.logic.conditions import Condition
from pnm.core.logic.domain import ActionSchema, DomainModel, Preference, ProblemModel
from pnm.core.logic.effects import OneOf, every_effect
from pnm.core.logic.expressions import DURATION, Constant, ValueOf, Variable, expression_fluents
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Bindings
from pnm.errors import InputError, Position, Tolerated, suggestion
from pnm.files.text import read_text
from pnm.files.yaml_keys import Key, Keys, listed, needed, pair, ref, text, written
from pnm.files.yaml_nodes import MAX_BYTES, Mapped, Node, compose
from pnm.language.domain import declaration_parts, read_facts, read_model
from pnm.language.formulas.readers import (
    ConditionsByMoment,
    OutcomeKeys,
    Quantified,
    read_condition,
    read_effects,
    read_expression,
    read_outcomes,
    read_quantified,
)
from pnm.language.formulas.scope import ANYTHING, FormulaScope, read_names, read_typed, shown
from pnm.language.formulas.words import CONDITION, Words, needed_form
from pnm.language.grammar import BINDING_KEYS, DomainKeys, NamedPlan, ProblemKeys
from pnm.language.plan import ANCHORS, domain_document

# --- constraints, preferences, metrics ------------------------------------------------------------
# The formulas that only planners read (PDDL 3.0).


_COUNTS: Final[Mapping[str, tuple[int, int]]] = {**CONSTRAINTS, "at_end": (0, 1)}
"""For every operator of a constraint, how many times and how many conditions it takes."""
_ABOUT: Final = {
    "always": "all the time",
    "sometime": "at some time",
    "at-most-once": "at one time at most",
    "at_end": "at the end",
    "sometime-after": "the second at some time after the first",
    "sometime-before": "the second at some time before the first",
    "within": "before so many seconds have passed",
    "always-within": "the second within so many seconds of the first",
    "hold-during": "between two times",
    "hold-after": "after so many seconds",
}
_CONSTRAINT: Final = ref("constraint")
_EXPRESSION: Final = ref("expression")


class QuantifiedConstraint(Quantified):
    """A constraint on all objects of some types."""

    body = needed(_CONSTRAINT, "the constraint on them").named("constraint")


_OPERANDS: Final = {word: [*[_EXPRESSION] * times, *[CONDITION] * conditions] for word, (times, conditions) in _COUNTS.items()}
CONSTRAINT_WORDS: Final[Words] = {
    **{word: (_ABOUT[word], operands[0] if len(operands) == 1 else pair(*operands)) for word, operands in _OPERANDS.items()},
    "forall": ("for all objects of some types", QuantifiedConstraint.json()),
}
"""The words that a constraint begins with."""
METRIC_WORDS: Final[Words] = {"minimize": ("as small as can be", _EXPRESSION), "maximize": ("as large as can be", _EXPRESSION)}
_MOMENTS: Final[Mapping[str, TimeSpecifier]] = {moment.replace(" ", "_"): moment for moment in TIME_SPECIFIERS}
_DIRECTIONS: Final[Mapping[str, Literal["minimize", "maximize"]]] = {"minimize": "minimize", "maximize": "maximize"}


class PreferenceKeys(Keys):
    """A preference."""

    name = text("a name that a metric may count it by")
    variables = listed(ref("typed"), "for all objects of these types")
    moment = Key(Mapped.string, {"enum": [*_MOMENTS]}, "when, for a durative action")
    condition = written(CONDITION, "the condition that should hold")
    constraints = listed(ref("constraints"), "the constraints that should hold")


def read_constraint(node: Node, scope: FormulaScope, variables: tuple[Variable, ...] = ()) -> Constraint:
    """Read a constraint, around which these variables are bound."""
    construct = needed_form(node, CONSTRAINT_WORDS, "a constraint")
    if construct.word == "forall":
        inner, body = read_quantified(QuantifiedConstraint(construct.argument.mapped()), scope)
        return read_constraint(body, scope.inside(inner), (*variables, *inner))
    times, conditions = _COUNTS[construct.word]
    operands = construct.items(times + conditions) if times + conditions > 1 else (construct.argument,)
    wanted = tuple([read_condition(operand, scope) for operand in operands[times:]])
    seconds: list[float] = []
    for operand in operands[:times]:
        value = operand.plain()
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < float("inf"):
            raise operand.wrong(f"expected a time of at least 0, found {operand.written or 'something else'}")
        seconds.append(float(value))
    return Constraint(construct.word.replace("_", " "), wanted, tuple(seconds), variables)


def read_preference(node: Node, scope: FormulaScope, *, timed: bool = False) -> Preference:
    """Read a preference; `timed` if it stands in a durative action, where it needs a moment."""
    keys = PreferenceKeys(node.mapped())
    entry = keys.entry
    variables: tuple[Variable, ...] = ()
    for quantifier in keys.variables:  # one for each text, which may hide variables of those before it
        variables += read_typed(quantifier, scope)
    scope = scope.inside(variables)
    wanted: Condition | tuple[Constraint, ...]
    if "constraints" in entry.nodes:
        wanted = tuple([read_constraint(constraint, scope) for constraint in keys.constraints])
    else:
        wanted = read_condition(entry.needed("condition"), scope)
    moment = keys.moment
    if moment is not None and moment not in _MOMENTS:
        hint = suggestion(moment, _MOMENTS.keys()) or f"expected one of {', '.join(_MOMENTS)}"
        raise InputError(f"unknown moment {moment!r}; {hint}", entry.position("moment"))
    if moment is not None and not timed:
        raise InputError("only a preference in an action with a duration has a moment", entry.position("moment"))
    if moment is None and timed:
        raise InputError(f"a preference in an action with a duration needs a moment, one of {', '.join(_MOMENTS)}", entry.start)
    return Preference(keys.name or "", wanted, variables, None if moment is None else _MOMENTS[moment])


def is_about_states(node: Node) -> bool:
    """Return whether the preference is about single states, as goals and preconditions are, rather than about their whole course."""
    return "constraints" not in node.mapped().nodes


def read_metric(node: Node | None, scope: FormulaScope, preferences: Collection[str]) -> Metric | None:
    """Read a metric; the names are those of the preferences that it may count."""
    if node is None:
        return None
    construct = needed_form(node, METRIC_WORDS, "a metric")
    argument = construct.argument
    expression = read_expression(argument)
    if isinstance(expression, Constant) and isinstance(expression.value, str):
        raise argument.wrong(f"expected a number or a function such as (total-time), found {expression}")
    for fluent in expression_fluents(expression):
        match fluent:
            case _ if fluent == TOTAL_TIME:
                pass
            case (word, name) if word == IS_VIOLATED:
                if name not in preferences:
                    hint = suggestion(name, preferences) or f"expected one of {', '.join(preferences) or 'none at all'}"
                    raise InputError(f"there is no preference {name!r} here; {hint}", argument.position_of(name))
            case _:
                scope.check_fluent(fluent, argument, "function")
                scope.check_value(ValueOf(fluent), (), argument)
    return Metric(_DIRECTIONS[construct.word], expression)


# --- domains and problems -------------------------------------------------------------------------


_LEFT_OUT: Final = ("instances", "external_knowledge_base", "knowledge", "action_types")
"""The keys of a domain that PDDL has nothing like."""
_KEYS: Final = {**NamedPlan.known, **DomainKeys.known}
_KEPT: Final = ("params", "preconditions", "effects", "outcomes", "duration", "preferences", *BINDING_KEYS)
"""The keys of an action that PDDL has, too, or a bindings file."""
_COMMENT: Final = re.compile(r"(?:(?<=\s)|(?<=\A)|(?<=\ufeff))#[^\r\n]*")
_CODE: Final = re.compile(r"^([ \t]*)[^\s#]", re.MULTILINE)
"""The beginning of a line that has more than a comment."""
_MARK: Final = re.compile(r"#+")
_FOR_EDITORS: Final = "# yaml-language-server:"
_PARTS: Final = {"params": "parameters", "duration": "duration", "preconditions": "condition", "effects": "effect"}
"""The keys of an action, and what PDDL's comments call them."""
_FORMULAS: Final = ("condition", "at_start", "effects")
"""The keys of a quantifier or of ``when`` that have formulas."""


@dataclass(frozen=True, slots=True)
class Contents:
    """A YAML file as planners see it."""

    domain: Domain
    problem: Problem | None
    comments: CommentTable
    bindings: Bindings
    """The bindings of its actions to servers."""

    def of(self, kind: str) -> CommentTable:
        """Return the comments of the domain, or of the problem."""
        return {path: note for path, note in self.comments.items() if path[:1] == (kind,)}


def read(path: Path) -> Contents:
    """Read a YAML file; raise `InputError` if the file cannot be read, is not such YAML, or has what PDDL has not."""
    return parse(read_text(path, MAX_BYTES), str(path))


def parse(text: str, file: str) -> Contents:
    """Read the text of a YAML file; raise `InputError` if it is not such YAML, or has what PDDL has not."""
    nodes = compose(text, file, ANCHORS)
    top = domain_document([node.mapped() for node in nodes])
    if top is None:
        raise InputError("there is no domain in the file; expected the key 'actions'", Position(file, 1, 1))
    top.only(*_KEYS, *_recipes(top))
    keys = DomainKeys(top)
    model = read_model(keys, strict=True)
    if not model.domain.name:
        model = replace(model, name=model.name or Path(file).stem, domain=replace(model.domain, name=Path(file).stem))
    _check_names(model, keys)
    domain = _domain(model, keys)
    problem = None if top.filled("problem") is None else _problem(model, domain, keys.problem)
    own = {name: action for name, action in keys.actions.items() if action.entry.nodes.keys() & BINDING_KEYS}
    bound = {name: read_binding(action, name, model.vocabulary if action.found else None) for name, action in own.items()}
    return Contents(domain, problem, comments(text, [node.raw for node in nodes], top, domain) if "#" in text else {}, Bindings(bound))


def _domain(model: ProblemModel, keys: DomainKeys) -> Domain:
    top, written = keys.entry, keys.actions
    scope = FormulaScope(model, {}, strict=True, borrows=top.filled("problem") is None)
    actions: dict[str, ActionSchema] = {}
    for name, schema in model.domain.actions.items():
        timed = schema.duration is not None
        inner = scope.inside((*schema.parameters, *((Variable(DURATION[0]),) if timed else ())))
        soft: list[Preference] = []
        for node in written[name].preferences:
            node.mapped().needed("condition")
            soft.append(read_preference(node, inner, timed=timed))
        actions[name] = replace(schema, preferences=tuple(soft))
    for preference in keys.preferences:
        preference.mapped().needed("constraints")  # no state that could be preferred is known here
    left_out = [(f"{key!r}", top.nodes[key][0]) for key in (*_LEFT_OUT, *_recipes(top)) if key in top.nodes]
    for name, action in written.items():
        left_out += [(f"{key!r} of {name}", position) for key, (position, _) in action.entry.nodes.items() if key not in _KEPT]
        named = (
            one for one in every_effect(actions[name].end_effects) if isinstance(one, OneOf) and any(way.name for way in one.alternatives)
        )
        left_out += [(f"'name' of outcomes of {name}", action.entry.position("outcomes")) for _ in islice(named, 1)]
    left_out.sort(key=lambda item: (item[1].line, item[1].column))
    return Domain(
        **{**_fields(model.domain), "actions": actions},
        requirements=_requirements(keys),
        constraints=tuple([read_constraint(node, scope) for node in keys.constraints]),
        preferences=tuple([read_preference(node, scope) for node in keys.preferences]),
        hierarchy=tuple([_hddl_text(node, HIERARCHY) for node in keys.hierarchy]),
        warnings=tuple([Tolerated(f"{what} is left out: PDDL has nothing like it", position) for what, position in left_out]),
    )


def _recipes(top: Mapped) -> list[str]:
    """Return the names of the plans that stand under their names."""
    others = top.nodes.keys() - _KEYS.keys()
    return [key for key, _, node in top.entries() if key in others and node.is_mapping and "plan" in node.mapped().nodes]


def _problem(model: ProblemModel, domain: Domain, section: ProblemKeys) -> Problem:
    scope = FormulaScope(model, {}, strict=True)
    soft = [read_preference(node, scope) for node in sorted(section.preferences, key=is_about_states, reverse=True)]
    every = (*soft, *domain.preferences, *(preference for schema in domain.actions.values() for preference in schema.preferences))
    return Problem(
        **{**_fields(model), "domain": domain, "init": {fluent: value for fluent, value in model.init.items() if value is not False}},
        metric=read_metric(section.metric, scope, {preference.name for preference in every if preference.name}),
        constraints=tuple([read_constraint(node, scope) for node in section.constraints]),
        preferences=tuple(soft),
        network="\n".join([_hddl_text(node, NETWORK) for node in section.network]),
        requirements=_requirements(section),
        warnings=domain.warnings,
    )


def _fields(model: DomainModel | ProblemModel) -> Mapping[str, Any]:
    kind = DomainModel if isinstance(model, DomainModel) else ProblemModel
    return {name: getattr(model, name) for name in kind.__dataclass_fields__}


def _requirements(keys: DomainKeys | ProblemKeys) -> tuple[str, ...]:
    """Read requirements, with or without their colons: a list of them, or a text of several."""
    words = [word for node in keys.requirements for word in node.written.split()]
    return tuple(dict.fromkeys(f":{word.lstrip(':').lower()}" for word in words))


def _hddl_text(node: Node, heads: tuple[str, ...]) -> str:
    """Read a section that is kept as its text."""
    lists = parse_lists(node.text, node.file) if node.text else ()
    if node.text and lists and isinstance(lists[0], Group) and lists[0].head in heads:
        return node.text
    raise node.wrong(f"expected the text of {' or '.join(heads)}, found {shown(node)}")


def _check_names(model: ProblemModel, keys: DomainKeys) -> None:
    """Refuse names that PDDL cannot have or cannot tell apart, and types that are kinds of themselves."""
    top, domain, section = keys.entry, model.domain, keys.entry.section("problem")
    _check_spelling("domain", [domain.name], top.node("name"))
    _check_spelling("problem", [model.name], section.node("name"))
    _check_spelling("requirement", [word[1:] for word in _requirements(keys)], top.node("requirements"))
    _check_spelling("type", domain.types, top.node("types"))
    _check_spelling("object", domain.constants, top.node("constants"))
    _check_spelling("object", model.own_objects, section.node("objects"))
    _check_spelling("predicate", domain.predicates, top.node("predicates"), CONNECTIVES)
    _check_spelling("function", domain.functions, top.node("functions"), CONNECTIVES)
    _check_spelling("action", domain.actions, top.node("actions"))
    _check_spelling("process", domain.processes, top.node("processes"))
    _check_spelling("event", domain.events, top.node("events"))
    for name, parents in domain.types.items():
        if any(name in domain.supertypes(parent) for parent in parents):
            raise InputError(f"the type {name!r} is a kind of itself", top.needed("types").position_of(name))
    for name, declared in domain.functions.items():
        same = domain.predicates.get(name)
        if same is not None and len(same.parameters) == len(declared.parameters):
            message = f"the function {name!r} has the name and the number of arguments of a predicate"
            raise InputError(message, top.needed("functions").position_of(name))


def _check_spelling(kind: str, names: Iterable[str], node: Node | None, forbidden: frozenset[str] = frozenset()) -> None:
    if node is None:
        return
    spelled: dict[str, str] = {}
    for name in names:
        if name.lower() in forbidden:
            raise InputError(f"{name!r} is a word of PDDL and cannot name {with_article(kind)}", node.position_of(name))
        if NAME.fullmatch(name) is None or NUMBER.fullmatch(name) is not None:
            message = f"{name!r} cannot name {with_article(kind)} in PDDL; expected letters, digits and _ - . @"
            raise InputError(message, node.position_of(name))
        if spelled.setdefault(name.lower(), name) != name:
            raise InputError(f"PDDL does not tell {name!r} from {spelled[name.lower()]!r}", node.position_of(name))


# --- comments ------------------------------------------------------------------------------
# The comments of a file, and the things they are about: named as in PDDL, so that they find their place there.


def comments(text: str, nodes: Iterable[yaml.Node], document: Mapped, domain: Domain) -> CommentTable:
    """Return the comments in the file of a domain, marked as in PDDL, given its documents and the one that has the domain."""
    lines = LineIndex.of(text)
    anchors = [*_Anchors(lines, domain).of_document(document)]
    outline = _Outline({anchor.path: anchor.start for anchor in anchors}, lines)
    return attach(_remarks(text, nodes), anchors, lines, outline.thing_above)


def _remarks(text: str, nodes: Iterable[yaml.Node]) -> Iterator[Comment]:
    """Yield the comments outside of scalars, with the marks of PDDL; not those that are for editors."""
    spans: list[tuple[int, int]] = []
    waiting = [*nodes]
    while waiting:
        node = waiting.pop()
        if isinstance(node, yaml.MappingNode):
            waiting.extend(part for pair in node.value for part in pair)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
        elif isinstance(node, yaml.ScalarNode) and node.style is not None:
            spans.append((node.start_mark.index, node.end_mark.index))
    spans.sort()
    starts = [start for start, _ in spans]
    for match in _COMMENT.finditer(text):
        before = bisect_right(starts, match.start())
        if not match.group().startswith(_FOR_EDITORS) and (not before or spans[before - 1][1] <= match.start()):
            yield Comment(_MARK.sub(lambda marks: ";" * len(marks[0]), match.group().rstrip(), count=1), match.start())


@dataclass(frozen=True, slots=True)
class _Outline:
    """The columns of things, by which a comment stands under one of them, or above what follows."""

    starts: dict[AnchorPath, int]
    """The beginnings of things."""
    lines: LineIndex

    def thing_above(self, remark: Comment, last: Anchor | None, following: Anchor | None) -> AnchorPath | None:
        column = self.lines.column(remark.offset)
        code = _CODE.search(self.lines.text, remark.offset)
        if last is None or (following is not None and code and column <= len(code[1])):
            return None
        path = last.path
        while path and (path not in self.starts or self.lines.indent(self.starts[path]) > column):
            path = path[:-1]
        return path or last.path[:1]


# --- the things of a file ------------------------------------------------------------------


def _condition(node: Node) -> pddl.Form:
    return pddl.condition_form(read_condition(node))


def _effect(node: Node) -> pddl.Form:
    return pddl.effects_form(read_effects(node).effects)


@dataclass(frozen=True, slots=True)
class _Anchors:
    lines: LineIndex
    domain: Domain

    def of_document(self, top: Mapped) -> Iterator[Anchor]:
        yield self._item(("domain",), top.nodes["name"][0] if "name" in top.nodes else Position(top.file, 1, 1))
        yield from self._sections(top, ("domain",))
        for key, where, node in top.entries():
            if key == "problem" and not node.is_null:
                yield self._item(("problem",), where)
                yield from self._sections(node.mapped(), ("problem",))

    def _item(self, path: AnchorPath, position: Position, *, opaque: bool = False) -> Anchor:
        offset = self.lines.starts[position.line - 1] + position.column - 1
        return Anchor(path, offset, offset + 1, opaque)

    def _sections(self, entry: Mapped, path: AnchorPath) -> Iterator[Anchor]:
        for key, where, node in entry.entries():
            section, items = (*path, f":{key}"), node.listed
            match key:
                case "requirements" | "types" | "constants" | "objects" | "predicates" | "functions" | "init" | "goal" | "metric":
                    yield self._item(section, where)
                    yield from self._inside(key, node, section)
                case "constraints":
                    yield self._item(section, where)
                    for item in items:
                        yield self._item((*section, pddl.form_anchor(pddl.constraint_form(read_constraint(item, ANYTHING)))), item.position)
                case "preferences":
                    for item in items:
                        holder = (*path, ":goal" if is_about_states(item) else ":constraints")
                        yield self._item((*holder, pddl.form_anchor(pddl.preference_form(read_preference(item, ANYTHING)))), item.position)
                case "derived":
                    for item, rule in zip(items, self.domain.rules, strict=True):
                        inner = (*section, pddl.rule_anchor(pddl.rule_form(rule)))
                        yield self._item(inner, item.position)
                        yield from self._formulas(item.mapped().needed("condition"), inner, _condition)
                case "hierarchy" | "network":
                    for item in items:
                        yield self._item((*path, *pddl.hierarchy_anchor(item.written)), item.position, opaque=True)
                case "actions" if not node.is_null:
                    for name, position, action in node.mapped().entries():
                        yield from self._action(self.domain.actions[name], position, action, (*path, pddl.ACTION))
                case "processes" | "events" if not node.is_null:
                    for name, position, one in node.mapped().entries():
                        yield from self._action(getattr(self.domain, key)[name], position, one, (*path, pddl.NATURE[key]))

    def _inside(self, key: str, node: Node, path: AnchorPath) -> Iterator[Anchor]:
        """Yield the things in a section that has names, declarations, facts or a formula."""
        if key == "goal" and not node.is_null:
            yield from self._formulas(node, path, _condition)
        for item in node.listed:
            match key:
                case "types" | "constants" | "objects" if not item.is_null:
                    yield from (self._item((*path, name.lower()), item.position_of(name)) for name in read_names(item))
                case "predicates" | "functions":
                    yield self._item((*path, declaration_parts(item)[0].lower()), item.position)
                case "init" if item.is_mapping:
                    time = item.mapped().needed("at").written
                    for fact in item.mapped().listed("facts"):
                        yield self._item((*path, pddl.fact_anchor(["at", time, _fact(fact)])), fact.position)
                case "init":
                    yield self._item((*path, pddl.fact_anchor(_fact(item))), item.position)

    def _action(self, schema: ActionSchema, position: Position, action: Node, path: AnchorPath) -> Iterator[Anchor]:
        inner = (*path, schema.name.lower())
        yield self._item(inner, position)
        for key, where, node in () if action.is_null else action.mapped().entries():
            if key in _PARTS:
                yield self._item((*inner, _PARTS[key]), where)
            if key in ("preconditions", "effects") and not node.is_null:
                yield from self._formulas(node, (*inner, _PARTS[key]), _condition if key == "preconditions" else _effect)
            if key == "outcomes" and not node.is_null:
                if "effects" not in action.mapped().nodes:
                    yield self._item((*inner, "effect"), where)
                whole = (*inner, "effect", pddl.form_anchor(pddl.effects_form((read_outcomes(node),))))
                yield self._item(whole, where)
                for part in _alternatives(node):
                    yield from self._formulas(part, whole, _effect)
            if key == "preferences":
                if "preconditions" not in action.mapped().nodes:
                    yield self._item((*inner, "condition"), where)
                for item in node.listed:
                    preference = read_preference(item, ANYTHING, timed=schema.duration is not None)
                    yield self._item((*inner, "condition", pddl.form_anchor(pddl.preference_form(preference))), item.position)

    def _formulas(self, node: Node, path: AnchorPath, form: Callable[[Node], pddl.Form]) -> Iterator[Anchor]:
        """Yield conditions or effects that stand beside each other, and those in them; ``and`` and moments are looked through."""
        entries = node.mapped().entries() if node.is_mapping else ()
        keys = [key.lower() for key, _, _ in entries]
        if node.items is not None:
            for item in node.items:
                yield from self._formulas(item, path, form)
        elif keys in (["and"], ["logicaland"]) or (keys and set(keys) <= set(ConditionsByMoment.known)):
            for _, _, value in entries:
                yield from self._formulas(value, path, form)
        elif not node.is_null and (keys or not node.is_mapping):
            whole = form(node)
            inner = (*path, pddl.form_anchor(whole))
            yield self._item(inner, node.position)
            for part, own_form in _parts(whole, node, form):
                yield from self._formulas(part, inner, own_form)


def _alternatives(node: Node) -> tuple[Node, ...]:
    """Return what happens in each of several outcomes."""
    return tuple([effects for item in node.listed if (effects := OutcomeKeys(item.mapped()).effects) is not None])


def _fact(node: Node) -> pddl.Form:
    ((fluent, value),) = read_facts((node,), ANYTHING).items()
    return pddl.change_form(fluent, value)


def _parts(whole: pddl.Form, node: Node, form: Callable[[Node], pddl.Form]) -> Iterator[tuple[Node, Callable[[Node], pddl.Form]]]:
    """Yield the formulas in another that comments can be about, each with how it is read: the negation of a fact has none."""
    match whole:
        case ["oneof" | "probabilistic", *_]:
            yield from ((part, _effect) for part in _alternatives(node.mapped().entries()[0][2]))
            return
        case ["not", [str() as head, *_]] if head not in pddl.COMPOUND and head != "and":
            return
        case [str() as head, *_] if head in pddl.COMPOUND:
            argument = node.mapped().entries()[0][2]
        case _:
            return
    entries = argument.mapped().entries() if argument.is_mapping else ()
    if any(key in _FORMULAS for key, _, _ in entries):
        yield from ((value, _effect if key == "effects" else _condition) for key, _, value in entries if key in _FORMULAS)
    else:
        yield argument, form
