"""The JSON Schema for editors knows every key that the readers know, and no other; and it accepts what they accept."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from click.testing import CliRunner
from hypothesis import given

from planner_bridge.cli.commands import app
from planner_bridge.cli.convert import exported
from pnm.actions.bindings_file import BindingKeys
from pnm.core import message_fields
from pnm.core.machine.bindings import Binding
from pnm.core.machine.failure_causes import Cause
from pnm.errors import InputError
from pnm.knowledge.sensor_file import FieldComparison
from pnm.language import grammar, steps
from pnm.language.formulas import words
from pnm.language.plan import parse_documents, read_plans
from tests.support.files import ROOT
from tests.support.yaml.programs import programs

SCHEMA = ROOT / "pnm" / "language" / "schema.json"
TEXT = SCHEMA.read_text(encoding="utf-8")
KNOWN = json.loads(TEXT)
PARTS = KNOWN["definitions"]
CHECK = jsonschema.Draft7Validator(KNOWN)
EXAMPLES = sorted(path for folder in ("domains", "problems") for path in (ROOT / folder).rglob("*.yaml") if "plans" in path.parts)


def violations(text: str) -> list[str]:
    """Return what the schema has against the documents of a text."""
    documents, _ = parse_documents(text, "F")
    plain = [{key: node.plain() for key, _, node in document.entries()} for document in documents]
    return [f"{list(error.path)}: {error.message}" for one in plain for error in CHECK.iter_errors(one)]


def mappings(part: Any) -> Iterator[dict[str, Any]]:
    """Yield every mapping in the schema."""
    if isinstance(part, dict):
        yield part
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from mappings(inner)


def test_the_file_is_what_the_command_writes(tmp_path: Path) -> None:
    assert CliRunner().invoke(app, ["schema"]).output == TEXT, f"pnm schema -o {SCHEMA.relative_to(ROOT)} --force writes it anew"
    done = CliRunner().invoke(app, ["schema", "-o", str(tmp_path / "pnm.json")])
    assert (done.exit_code, done.output) == (0, f"wrote {tmp_path / 'pnm.json'}\n")
    assert (tmp_path / "pnm.json").read_text(encoding="utf-8") == TEXT


def test_the_keys_are_those_of_the_core() -> None:
    bound = {*BindingKeys.known}
    assert bound == {field.name for field in fields(Binding) if field.compare}
    assert {*FieldComparison.known} == {"field", *message_fields.COMPARISONS}
    assert {*grammar.During.known} == {*steps._DURING}


def test_the_pages_name_every_step_and_every_cause_of_failure() -> None:
    pages = {name: (ROOT / f"docs/reference/{name}.md").read_text(encoding="utf-8") for name in ("language", "failures")}
    assert not [word for word in grammar.RESERVED if f"`{word}`" not in pages["language"]]
    assert not [cause for cause in Cause if f"`{cause}`" not in pages["failures"] and cause not in (Cause.BEFORE, Cause.AFTER)]


def test_words_may_be_spelled_as_the_readers_allow() -> None:
    for word in ("and", "or", "not", "logicalAnd", "logicalOr", "logicalNot", "comparison", "holds", *words.QUERIES):
        for spelled in (word, word[0].upper() + word[1:]):
            argument = {"comparison": "[eq, [1, 2]]", "holds": "(a)"}.get(word, "{Query: v}" if "uery" not in word else "v")
            assert not violations(f"goal: {{{spelled}: {argument}}}\nplan: []"), spelled


def test_it_is_a_schema_and_what_it_refers_to_is_defined() -> None:
    jsonschema.Draft7Validator.check_schema(KNOWN)
    used = {part["$ref"].rpartition("/")[2] for part in mappings(KNOWN) if isinstance(part.get("$ref"), str)}
    assert used <= PARTS.keys()


def test_every_key_is_described_in_a_sentence() -> None:
    for part in mappings(KNOWN):
        if isinstance(part.get("properties"), dict):
            for key, value in part["properties"].items():
                assert re.fullmatch(r"[A-Z`].*\w.*\.", value["description"]), key


# --- what is accepted, and what is not -----------------------------------------------------


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_examples_are_valid_and_name_the_schema(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert violations(text) == []
    modeline, _, _ = text.partition("\n")
    start, _, target = modeline.partition("$schema=")
    assert start == "# yaml-language-server: "
    assert (path.parent / target).resolve() == SCHEMA.resolve()


@pytest.mark.parametrize("name", ["delivery", "mall_guide", "patrol"])
def test_exported_domains_are_valid(name: str) -> None:
    found = exported(ROOT / "domains" / name / "domain.pddl", ROOT / "problems" / name / "p01.pddl", with_plan=True)
    assert violations(found.text) == []


@given(programs())
def test_any_program_is_valid(text: str) -> None:
    assert violations(text) == []


WRONG = {
    "unknown key": "plan: []\ngaol: (a)",
    "unknown key of an action": "actions: {a: {precondition: (a)}}\nplan: []",
    "unknown kind": "actions: {a: {type: ros}}\nplan: []",
    "unknown key of a problem": "actions: {a: }\nproblem: {start: [(a)]}\nplan: []",
    "unknown word": "actions: {a: }\nplan: []\ngoal: {Comparisn: [eq, [1, 2]]}",
    "unknown operator": "actions: {a: }\nplan: []\ngoal: {Comparison: [equals, [1, 2]]}",
    "two forms at once": "actions: {a: }\nplan: []\ngoal: {and: [(a)], or: [(b)]}",
    "three sides": "actions: {a: }\nplan: []\ngoal: {Comparison: [eq, [1, 2, 3]]}",
    "no fact": "actions: {a: }\nplan: []\ngoal: kitchen",
    "no list of steps": "actions: {a: }\nplan: {a: {}}",
    "no step": "actions: {a: }\nplan: [a]",
    "arguments without names": "actions: {a: }\nplan: [{a: [1]}]",
    "loop without condition": "actions: {a: }\nplan: [{while: {actions: [{a: }]}}]",
    "loop without limit": "actions: {a: }\nplan: [{while: {condition: (a), actions: [{a: }], limit: 0}}]",
    "misspelt loop": "actions: {a: }\nplan: [{while: {condition: (a), action: [{a: }]}}]",
    "choice without then": "actions: {a: }\nplan: [{if: (a), else: [{a: }]}]",
    "then without if": "actions: {a: }\nplan: [{then: [{a: }]}]",
    "unknown moment": "actions: {a: {duration: 1, preconditions: {at_begin: (a)}}}\nplan: []",
    "unknown effect": "actions: {a: {effects: [{incraese: [(a), 1]}]}}\nplan: []",
    "unknown outcome": "actions: {a: {recoveries: {during: {abort: retry}}}}\nplan: []",
    "unknown command": "actions: {a: {recoveries: {before: rety}}}\nplan: []",
    "too often": "actions: {a: {recoveries: {after: {do: retry, times: 0}}}}\nplan: []",
    "nothing to do": "actions: {a: {recoveries: {after: {when: (a), times: 1}}}}\nplan: []",
    "negative time": "actions: {a: {timeout: -1}}\nplan: []",
    "half a retry": "actions: {a: {retries: 0.5}}\nplan: []",
    "resources without list": "actions: {a: {resources: arm}}\nplan: []",
    "no capacity": "actions: {a: }\nresources: {arm: 0}\nplan: []",
    "unknown end": "actions: {a: }\non_failure: stop\nplan: []",
    "unknown bound": "actions: {a: {duration: [{'<': 3}]}}\nplan: []",
    "recipe without plan": "actions: {a: }\nother: {initial_knowledge: {}}",
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_by_reader_and_schema(name: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(WRONG[name], encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_plans(path)
    assert caught.value.position
    assert violations(WRONG[name])


def test_worlds_are_valid() -> None:
    assert not violations("domain: d.yaml\nplans: [a.yaml, b.yaml]")
    assert not violations("one: {domain: d.yaml, recipes: [a.yaml]}\ntwo: {domain: e.yaml, recipes: [b.yaml]}")
    assert violations("one: {domain: d.yaml, recipes: [a.yaml], plan: []}")
