"""The JSON Schema of the language, by which editors complete and check its files, as it follows from the grammar."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

from planner_bridge.yaml.reader import CONSTRAINT_WORDS, METRIC_WORDS, PreferenceKeys
from pnm.actions.bindings_file import DEFINITIONS
from pnm.files.yaml_keys import TEXT, Keys, Schema, pair, ref
from pnm.language import grammar
from pnm.language.formulas import readers, words

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
