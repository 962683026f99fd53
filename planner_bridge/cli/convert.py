"""`pnm export`, `pnm import` and `pnm schema`: PDDL and behaviour trees as YAML and back, and what editors check YAML by."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import click

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.comments import CommentTable
from planner_bridge.pddl.reader import MAX_BYTES, comments
from planner_bridge.pddl.writer import write_domain as domain_text, write_problem as problem_text
from planner_bridge.pipeline.loading import bindings_for
from planner_bridge.planning.solve import solve
from planner_bridge.yaml.reader import CONSTRAINT_WORDS, METRIC_WORDS, PreferenceKeys, read
from planner_bridge.yaml.trees import Tree, plan_tree, policy_tree, read_tree
from planner_bridge.yaml.writer import plan_entries, unwritten, write_bindings, write_domain, write_problem
from pnm.actions.bindings_file import DEFINITIONS
from pnm.core.logic.domain import ProblemModel
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.core.message_fields import Combined, Test
from pnm.errors import InputError, Tolerated, suggestion
from pnm.files.text import read_any_text, read_text
from pnm.files.yaml_keys import TEXT, Keys, Schema, pair, ref
from pnm.language import grammar
from pnm.language.formulas import readers, words
from pnm.language.plan import chosen_plan, read_plans


@click.command(epilog="Example: pnm export domain.pddl problem.pddl -o robots.yaml --with-plan")
@click.argument("domain", type=options.FILE)
@click.argument("problem", type=options.FILE, required=False)
@click.option(
    "--format",
    "written_as",
    type=click.Choice(["yaml", "btcpp"]),
    default="yaml",
    show_default=True,
    help="btcpp is the plan as a behaviour tree, for BehaviorTree.CPP 4 and Groot2; DOMAIN may be a file with a hand-written plan",
)
@click.option("--name", help="the plan of that file, if it has several")
@options.output_options
@click.option("--with-plan", is_flag=True, help="also find and write a plan for the problem")
@options.bindings_option
@options.planning
@options.command
def export(
    *,
    domain: Path,
    problem: Path | None,
    output: Path | None,
    force: bool,
    written_as: str,
    name: str | None,
    with_plan: bool,
    bindings: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
) -> int:
    """Write a domain, a problem and a plan as YAML.

    With --format btcpp only the plan, as a behaviour tree. What a tree cannot say is printed.
    """
    is_by_hand = written_as == "btcpp" and problem is None
    if name and not is_by_hand:
        raise InputError("--name chooses a hand-written plan; expected --format btcpp and its file, without PROBLEM")
    if is_by_hand:
        plans = read_plans(domain)
        chosen = plans[chosen_plan(plans, name)]
        options.print_warnings(chosen.warnings)
        return _write_tree(plan_tree(chosen.graph), output, force=force)
    if written_as == "btcpp" and problem:
        loaded, found, _, _ = options.planned((domain, problem), bindings, None, planner, planner_timeout, improve)
        if found.plan is None:
            SafeConsole(stderr=True).print_reason("no plan:", found.reason)
            return 1
        policy = options.policy_of(found)
        tree = policy_tree(policy.as_json(), loaded.goal) if policy else plan_tree(plan_graph(loaded, found.plan))
        return _write_tree(tree, output, force=force)
    bound = bindings_for(domain, bindings, None)
    with options.searching(planner, planner_timeout) if with_plan else nullcontext():
        result = exported(domain, problem, with_plan=with_plan, bindings=bound, planner=planner, timeout=planner_timeout, improve=improve)
    options.print_warnings(result.warnings)
    if result.reason:
        SafeConsole(stderr=True).print_reason("no plan:", result.reason)
        return 1
    if left_out := [f"{key!r}" for key in unwritten(bound)]:
        print(f"{' and '.join(left_out)} of the bindings are not in the text: give --bindings when it is run", file=sys.stderr)
    options.write(output, result.text, force=force)
    return 0


def _write_tree(tree: Tree, output: Path | None, *, force: bool) -> int:
    options.write(output, tree.text, force=force)
    for lost in tree.lost:
        print(f"lost     {lost}", file=sys.stderr)
    return 0


@click.command("import", epilog="Example: pnm import robots.yaml -o robots")
@click.argument("file", type=options.FILE)
@click.option(
    "-o",
    "--output",
    type=options.FILE,
    required=True,
    help="the folder of domain.pddl, problem.pddl and bindings.yaml, or of plan.yaml; created if missing",
)
@options.force_option
@options.command
def from_yaml(file: Path, output: Path, force: bool) -> int:
    """Write YAML as PDDL, or a tree as a plan.

    Also writes its problem, if it has one, and its bindings as bindings.yaml. A file of BehaviorTree.CPP (.xml) becomes plan.yaml: a plan
    for each tree, the main tree first, which `pnm run --plan` carries out by its --name.
    """
    is_tree = file.suffix.lower() == ".xml"
    result = Imported({"plan.yaml": read_tree(read_text(file, MAX_BYTES), str(file))}) if is_tree else imported(file)
    options.print_warnings(result.warnings)
    try:
        output.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{output}: not a folder, and none can be made there: {error.strerror}") from error
    options.write_files({output / name: text for name, text in result.texts.items()}, force=force)
    return 0


@click.command(epilog="Example: pnm schema -o pnm.json")
@options.output_options
@options.command
def schema(output: Path | None, force: bool) -> int:
    """Write the JSON Schema of YAML files, for editors.

    Editors complete and check plans, domains and worlds with it.
    """
    options.write(output, schema_text(), force=force)
    return 0


# --- from files to texts --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Exported:
    """A YAML text, or why there is none."""

    text: str = ""
    warnings: tuple[Tolerated, ...] = ()
    reason: str = ""
    """Why no plan was found."""


@dataclass(frozen=True, slots=True)
class Imported:
    """PDDL texts, and that of a bindings file, by the names of their files."""

    texts: Mapping[str, str]
    warnings: tuple[Tolerated, ...] = ()


def exported(
    domain: Path,
    problem: Path | None,
    *,
    with_plan: bool = False,
    bindings: Bindings = NO_BINDINGS,
    planner: str = "kairos",
    timeout: float = 30.0,
    improve: float | None = None,
) -> Exported:
    """Return a PDDL domain as YAML: alone, with a problem for it, or with a plan besides, which the planner has `timeout` seconds to find.

    Bindings are written beside the actions. Raises `InputError` if a file is wrong, or has what cannot be written.
    """
    model = read_domain(domain)
    for name in bindings.actions.keys() - model.actions.keys():
        hint = suggestion(name, model.actions.keys())
        raise InputError(f"the bindings have an action {name!r}, which is not in {domain}{hint and f'; {hint}'}")
    if problem is None:
        if with_plan:
            raise InputError(f"a plan is for a problem; expected its file after {domain}")
        return Exported(write_domain(model, _comments(domain, "domain"), bindings), model.warnings)
    whole = read_problem(problem, model)
    if not with_plan:
        return Exported(write_problem(whole, _both(domain, problem), bindings=bindings), whole.warnings)
    result = solve(whole, planner=planner, timeout=timeout, improve=improve, bindings=bindings)
    if result.plan is None:
        return Exported(warnings=whole.warnings, reason=result.reason)
    graph = plan_graph(whole, result.plan)
    return Exported(write_problem(whole, _both(domain, problem), plan_entries(graph, whole.domain), bindings), whole.warnings)


def imported(file: Path) -> Imported:
    """Return a YAML file as PDDL and bindings; raise `InputError` if it is wrong, or has what PDDL has not."""
    contents = read(file)
    texts = {"domain.pddl": domain_text(contents.domain, contents.of("domain"))}
    domain = parse_domain(texts["domain.pddl"], "domain.pddl")  # which warns of requirements that other planners will miss
    warnings = (*contents.domain.warnings, *domain.warnings)
    model = ProblemModel("", domain)
    if contents.problem:
        texts["problem.pddl"] = problem_text(contents.problem, contents.of("problem"))
        model = problem = parse_problem(texts["problem.pddl"], domain, "problem.pddl")
        warnings = (*contents.domain.warnings, *problem.warnings)
    bound, before = dict(contents.bindings.actions), contents.problem or ProblemModel("", contents.domain)
    for name, binding in contents.bindings.actions.items():
        if binding.outcomes:  # which have no names in PDDL, and are equal there if they differ in nothing else
            numbers, tests = {frozenset(way.effects): way.name for way in model.outcomes(name)}, dict[str, list[Test]]()
            for way in before.outcomes(name):
                if way.name in binding.outcomes:
                    tests.setdefault(numbers[frozenset(way.effects)], []).append(binding.outcomes[way.name])
            told = {number: some[0] if len(some) == 1 else Combined("any", tuple(some)) for number, some in tests.items()}
            bound[name] = replace(binding, outcomes=told)
    if text := write_bindings(replace(contents.bindings, actions=bound)):
        texts["bindings.yaml"] = text
    return Imported(texts, warnings)


def _both(domain: Path, problem: Path) -> CommentTable:
    return {**_comments(domain, "domain"), **_comments(problem, "problem")}


def _comments(file: Path, kind: Literal["domain", "problem"]) -> CommentTable:
    return comments(read_any_text(file, MAX_BYTES)[0], kind)


# --- schema ---------------------------------------------------------------------------------------
# The JSON Schema of the language, by which editors complete and check its files, as it follows from the grammar.


_OBJECT: Final[Schema] = {"type": "object"}
_LIST: Final[Schema] = {"type": "array"}


def schema_text() -> str:
    """Return the schema of a file as JSON, a line for each key and definition."""
    definitions = dict((*_steps(), *_formulas()))
    whole = {"$schema": "http://json-schema.org/draft-07/schema#", "title": "PNM language", **grammar.Document.json()}
    parts = {"definitions": {"action": grammar.Action.json(), **definitions}, "properties": whole.pop("properties")}
    lines = [f" {json.dumps(key)}: {json.dumps(part, ensure_ascii=False)}" for key, part in whole.items()]
    for key, part in parts.items():
        inner = ",\n".join(f"  {json.dumps(name)}: {json.dumps(about, ensure_ascii=False)}" for name, about in part.items())
        lines.append(f" {json.dumps(key)}: {{\n{inner}\n }}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _either(test: Schema, then: Schema, otherwise: Schema) -> dict[str, Any]:
    """Return the schema of what is one thing if it passes a test, and another if not."""
    return {"if": test, "then": then, "else": otherwise}


def _one_or_several(item: Schema, about: str) -> Schema:
    """Return the schema of a list, or of a mapping that stands for itself."""
    return {"description": about, "type": ["object", "array", "null"], **_either(_LIST, {"items": item}, _either(_OBJECT, item, {}))}


def _steps() -> Iterator[tuple[str, Schema]]:
    step, command, chain = ref("step"), ref("command"), ref("chain")
    arguments = {
        "description": "Calls an action or a plan: parameters and their values.",
        "type": ["object", "null"],
        "properties": {"operation": {"description": "What an action on knowledge does.", "allOf": [ref("operation")]}},
        "additionalProperties": words.VALUE,
    }
    own = [{name: key for name, key in block.known.items() if name not in grammar.Place.known} for block in grammar.BLOCKS.values()]
    yield "steps", {"description": "A list of steps.", "type": ["array", "null"], "items": step}
    call_or_block = {
        "description": "A call of an action, a block of steps, or a list of steps.",
        "type": ["object", "array"],
        "items": step,
        "properties": _properties(*grammar.BLOCKS.values(), grammar.Call),
        "additionalProperties": arguments,
        "minProperties": 1,
        "dependencies": {name: [other for other in keys if keys[other].is_needed and other != name] for keys in own for name in keys},
    }
    yield "step", call_or_block
    wait = {"description": "The id of a step, or its start or end.", "type": ["string", "object"]}
    yield "wait", {**wait, **_either(_OBJECT, grammar.WaitFor.json(), {})}
    yield "waits", {"description": "A step, or several.", **_either(_LIST, {"items": ref("wait")}, ref("wait"))}
    yield "recoveries", grammar.RecoveryKeys.json()
    yield "command", {"description": "How a chain ends.", "enum": [*grammar.COMMANDS]}
    link = _either(TEXT, command, step)
    yield "chain", {"description": "Steps and a command.", **_either(_LIST, {"minItems": 1, "items": link}, command)}
    long = grammar.ConditionalChain.json()
    several = {"minItems": 1, "items": _either({**_OBJECT, "required": ["do"]}, long, link)}
    recovery = {
        "description": "A chain of steps that ends in a command, or such chains with conditions and limits.",
        "type": ["string", "array", "object", "null"],
    }
    yield "recovery", {**recovery, **_either(_LIST, several, _either(_OBJECT, long, _either({"type": "null"}, {}, chain)))}


def _properties(*kinds: type[Keys]) -> dict[str, Schema]:
    return {name: key.about for kind in kinds for name, key in kind.known.items()}


def _formula(about: str, name: str, known: words.Words, moments: type[Keys]) -> Iterator[tuple[str, Schema]]:
    """Yield the definition of a kind of formula, and of such formulas by moment."""
    types = ["string", "boolean", "array", "object", "null"]
    whole = {"description": about, "type": types, "pattern": r"^\s*(\(.*\)|\?\S+)\s*$", "items": ref(name), **words.forms(known)}
    yield name, whole
    timed = {**whole["properties"], **_properties(moments)}
    yield f"{name}ByMoment", {**whole, "properties": timed, "maxProperties": len(moments.known)}


def _formulas() -> Iterator[tuple[str, Schema]]:
    about = "A fact such as (at ?r kitchen), a list, or a form such as Comparison."
    yield from _formula(about, "condition", words.TESTS, readers.ConditionsByMoment)
    about = "A fact that becomes true, a list, or a form such as increase."
    yield from _formula(about, "effects", readers.EFFECT_WORDS, readers.EffectsByMoment)
    queries = {"description": "A query.", "type": "object", "minProperties": 1, **words.forms(words.QUERY_WORDS)}
    query = _either(_LIST, {"minItems": 1, "maxItems": 1, "items": queries}, queries)
    yield "quantified", readers.Quantified.json()
    yield "quantifiedEffects", _either({"required": ["effects"]}, readers.QuantifiedEffects.json(), readers.Quantified.json())
    yield "exists", _either({**_OBJECT, "required": ["variables"]}, readers.Quantified.json(), query)
    yield "when", {**readers.Conditional.json(), "required": ["effects"]}
    ways = _either(_LIST, {"minItems": 1, "items": readers.OutcomeKeys.json()}, readers.OutcomeKeys.json())
    yield "outcomes", {"description": "Ways in which effects may turn out.", "type": ["array", "object"], **ways}
    yield "comparison", pair(ref("operator"), pair(words.VALUE, words.VALUE))
    yield "computed", pair(ref("operator"), _either(_LIST, {"items": words.VALUE, "minItems": 1}, words.VALUE))
    yield "operator", {"description": "One of Python's operators by its name, or a symbol.", "enum": words.OPERATORS_KNOWN}
    name = {"type": ["string", "object"]}
    yield "query", _either(_LIST, {"minItems": 1, "maxItems": 2, "items": words.VALUE}, name)
    yield "update", {"type": "array", "minItems": 2, "maxItems": 3, "items": words.VALUE}
    yield "operation", {"description": "An update, a query, or an operation such as setitem.", **words.forms(words.OPERATIONS, most=None)}
    yield "value", {"description": "Anything; a form such as LocalQuery is computed.", **words.forms(words.VALUES, most=None)}
    kinds = ["number", "string", "object"]
    arithmetic = {"description": "A number, a name, a parameter, or arithmetic.", "type": kinds, **words.forms(words.ARITHMETIC_WORDS)}
    yield "expression", arithmetic
    bound = {"type": "object", "minProperties": 1, **words.forms(readers.BOUND_WORDS)}
    either_way = words.forms({**words.ARITHMETIC_WORDS, **readers.BOUND_WORDS})
    duration = {"description": "An expression, or a list of bounds.", "type": [*kinds, "array", "null"]}
    yield "duration", {**duration, **_either(_LIST, {"items": bound}, either_way)}
    fact = {"type": "string", "pattern": r"^\s*\(.*\)\s*$"}
    yield "factOrOne", _either(_LIST, {"minItems": 1, "maxItems": 1, "items": words.FLUENT}, words.FLUENT)
    yield "facts", {"type": ["array", "string", "null"], **_either(_LIST, {"items": fact}, {"pattern": fact["pattern"]})}
    yield "typed", {"type": ["string", "array", "null"], "items": {"type": ["string", "null"]}}
    yield "texts", {"type": ["string", "array", "null"], "items": TEXT}
    yield from DEFINITIONS.items()
    whole = {"description": "A constraint on the course of a plan.", "type": "object", "minProperties": 1}
    yield "constraint", {**whole, **words.forms(CONSTRAINT_WORDS)}
    yield "constraints", _one_or_several(ref("constraint"), "Constraints; all of them.")
    yield "preference", PreferenceKeys.json()
    yield "preferences", _one_or_several(ref("preference"), "Preferences.")
    yield "metric", {"type": ["object", "null"], **words.forms(METRIC_WORDS)}
