"""The JSON Schema of the language, by which editors complete and check its files, as it follows from the grammar."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

from planner_bridge.yaml.read_constraints import CONSTRAINT_WORDS, METRIC_WORDS, PreferenceKeys
from pnm.actions.bindings_file import DEFINITIONS
from pnm.files.yaml_keys import TEXT, Keys, Schema, pair, ref
from pnm.language import grammar
from pnm.language.formulas.conditions import Quantified
from pnm.language.formulas.effects import BOUND_WORDS, EFFECT_WORDS, Conditional, ConditionsByMoment, EffectsByMoment, QuantifiedEffects
from pnm.language.formulas.words import (
    ARITHMETIC_WORDS,
    FLUENT,
    OPERATIONS,
    OPERATORS_KNOWN,
    QUERY_WORDS,
    TESTS,
    VALUE,
    VALUES,
    Words,
    forms,
)

_OBJECT: Final[Schema] = {"type": "object"}
_LIST: Final[Schema] = {"type": "array"}


def schema_text() -> str:
    """Return the schema of a file as JSON, a line for each key and definition."""
    definitions = {**dict(_steps()), **dict(_formulas()), **dict(_texts()), **DEFINITIONS, **dict(_planning())}
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
    """Yield the definitions of steps and of what stands in them."""
    step, command, chain = ref("step"), ref("command"), ref("chain")
    arguments = {
        "description": "Calls an action or a plan: parameters and their values.",
        "type": ["object", "null"],
        "properties": {"operation": {"description": "What an action on knowledge does.", "allOf": [ref("operation")]}},
        "additionalProperties": VALUE,
    }
    own = [{name: key for name, key in block.known.items() if name not in grammar.Place.known} for block in grammar.BLOCKS.values()]
    yield "steps", {"description": "A list of steps.", "type": ["array", "null"], "items": step}
    yield (
        "step",
        {
            "description": "A call of an action, a block of steps, or a list of steps.",
            "type": ["object", "array"],
            "items": step,
            "properties": _properties(*grammar.BLOCKS.values(), grammar.Call),
            "additionalProperties": arguments,
            "minProperties": 1,
            "dependencies": {name: [other for other in keys if keys[other].is_needed and other != name] for keys in own for name in keys},
        },
    )
    wait = {"description": "The id of a step, or its start or end.", "type": ["string", "object"]}
    yield "wait", {**wait, **_either(_OBJECT, grammar.WaitFor.json(), {})}
    yield "waits", {"description": "A step, or several.", **_either(_LIST, {"items": ref("wait")}, ref("wait"))}
    yield "recoveries", grammar.RecoveryKeys.json()
    yield "command", {"description": "How a chain ends.", "enum": [*grammar.COMMANDS]}
    link = _either(TEXT, command, step)
    yield "chain", {"description": "Steps and a command.", **_either(_LIST, {"minItems": 1, "items": link}, command)}
    long = grammar.ConditionalChain.json()
    yield (
        "recovery",
        {
            "description": "A chain of steps that ends in a command, or such chains with conditions and limits.",
            "type": ["string", "array", "object", "null"],
            **_either(
                _LIST,
                {"minItems": 1, "items": _either({**_OBJECT, "required": ["do"]}, long, link)},
                _either(_OBJECT, long, _either({"type": "null"}, {}, chain)),
            ),
        },
    )


def _properties(*kinds: type[Keys]) -> dict[str, Schema]:
    return {name: key.about for kind in kinds for name, key in kind.known.items()}


def _formula(about: str, name: str, words: Words, moments: type[Keys]) -> Iterator[tuple[str, Schema]]:
    """Yield the definition of a kind of formula, and of such formulas by moment."""
    types = ["string", "boolean", "array", "object", "null"]
    whole = {"description": about, "type": types, "pattern": r"^\s*(\(.*\)|\?\S+)\s*$", "items": ref(name), **forms(words)}
    yield name, whole
    timed = {**whole["properties"], **_properties(moments)}
    yield f"{name}ByMoment", {**whole, "properties": timed, "maxProperties": len(moments.known)}


def _formulas() -> Iterator[tuple[str, Schema]]:
    """Yield the definitions of formulas and of what stands in them."""
    yield from _formula("A fact such as (at ?r kitchen), a list, or a form such as Comparison.", "condition", TESTS, ConditionsByMoment)
    yield from _formula("A fact that becomes true, a list, or a form such as increase.", "effects", EFFECT_WORDS, EffectsByMoment)
    queries = {"description": "A query.", "type": "object", "minProperties": 1, **forms(QUERY_WORDS)}
    query = _either(_LIST, {"minItems": 1, "maxItems": 1, "items": queries}, queries)
    yield "quantified", Quantified.json()
    yield "quantifiedEffects", _either({"required": ["effects"]}, QuantifiedEffects.json(), Quantified.json())
    yield "exists", _either({**_OBJECT, "required": ["variables"]}, Quantified.json(), query)
    yield "when", {**Conditional.json(), "required": ["effects"]}
    yield "comparison", pair(ref("operator"), pair(VALUE, VALUE))
    yield "computed", pair(ref("operator"), _either(_LIST, {"items": VALUE, "minItems": 1}, VALUE))
    yield "operator", {"description": "One of Python's operators by its name, or a symbol.", "enum": OPERATORS_KNOWN}
    name = {"type": ["string", "object"]}
    yield "query", _either(_LIST, {"minItems": 1, "maxItems": 2, "items": VALUE}, name)
    yield "update", {"type": "array", "minItems": 2, "maxItems": 3, "items": VALUE}
    yield "operation", {"description": "An update, a query, or an operation such as setitem.", **forms(OPERATIONS, most=None)}
    yield "value", {"description": "Anything; a form such as LocalQuery is computed.", **forms(VALUES, most=None)}
    kinds = ["number", "string", "object"]
    yield "expression", {"description": "A number, a name, a parameter, or arithmetic.", "type": kinds, **forms(ARITHMETIC_WORDS)}
    bound = {"type": "object", "minProperties": 1, **forms(BOUND_WORDS)}
    either_way = forms({**ARITHMETIC_WORDS, **BOUND_WORDS})
    duration = {"description": "An expression, or a list of bounds.", "type": [*kinds, "array", "null"]}
    yield "duration", {**duration, **_either(_LIST, {"items": bound}, either_way)}


def _texts() -> Iterator[tuple[str, Schema]]:
    """Yield the definitions of texts as PDDL has them."""
    fact = {"type": "string", "pattern": r"^\s*\(.*\)\s*$"}
    yield "factOrOne", _either(_LIST, {"minItems": 1, "maxItems": 1, "items": FLUENT}, FLUENT)
    yield "facts", {"type": ["array", "string", "null"], **_either(_LIST, {"items": fact}, {"pattern": fact["pattern"]})}
    yield "typed", {"type": ["string", "array", "null"], "items": {"type": ["string", "null"]}}
    yield "texts", {"type": ["string", "array", "null"], "items": TEXT}


def _planning() -> Iterator[tuple[str, Schema]]:
    """Yield the definitions of what only planners read."""
    constraint, preference = ref("constraint"), ref("preference")
    yield (
        "constraint",
        {"description": "A constraint on the course of a plan.", "type": "object", "minProperties": 1, **forms(CONSTRAINT_WORDS)},
    )
    yield "constraints", _one_or_several(constraint, "Constraints; all of them.")
    yield "preference", PreferenceKeys.json()
    yield "preferences", _one_or_several(preference, "Preferences.")
    yield "metric", {"type": ["object", "null"], **forms(METRIC_WORDS)}
