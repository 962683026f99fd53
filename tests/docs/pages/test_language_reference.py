"""Every example of docs/reference/language.md is read: files and their machines proved, conditions and values as it says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import CHANGING, OPERATORS, compute
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.files.yaml_nodes import Node, parse_yaml
from pnm.language import read_domain, read_world
from pnm.language.formulas.readers import read_condition, read_effects
from pnm.language.formulas.words import read_data
from pnm.language.grammar import COMMANDS
from pnm.language.runner import Program
from tests.support.docs.page import DOCS, blocks_of, files_of
from tests.support.files import ROOT

TEXT = (DOCS / "reference" / "language.md").read_text(encoding="utf-8")
FILES = files_of(TEXT)
COMMANDS_SHOWN = [step.command for block in blocks_of(TEXT, "console") for step in block.steps()]
FACTS: dict[Fluent, Value | Unknown] = {("at", "r1", "kitchen"): True, ("battery", "r1"): 80.0}
KNOWN = EvaluationContext(Layered(KnowledgeBase(FACTS, objects={"robot": ("r1", "r2")}), KnowledgeBase(variables={"v": 3, "list": [1, 2]})))


def items(kind: str) -> list[tuple[Node, str]]:
    """Return the items of a list, each with what the comment behind it says."""
    (body,) = [block.body for block in blocks_of(TEXT, "yaml") if block.name == kind]
    (top,) = parse_yaml("items:\n" + body, kind)
    node = top.node("items")
    assert node is not None
    assert node.items is not None
    return list(zip(node.items, re.findall(r"  # (.*)", body), strict=True))


def test_every_file_is_shown_in_use_or_read(tmp_path: Path) -> None:
    used = {word for command in COMMANDS_SHOWN for word in command.split()}
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert FILES.keys() - used == {"kitchen.yaml", "world.yaml"}
    assert read_domain(tmp_path / "kitchen.yaml").actions
    assert all(Program.of(plan) for plan in read_world(tmp_path / "world.yaml").plans.values())


@pytest.mark.parametrize("number", range(len(items("conditions"))))
def test_conditions_are_as_the_page_says(number: int) -> None:
    node, said = items("conditions")[number]
    found = evaluate(read_condition(node), KNOWN)
    assert {True: "true", False: "false"}.get(found is True if not isinstance(found, Unknown) else found, "unknown") == said.partition(":")[
        0
    ]


@pytest.mark.parametrize("number", range(len(items("values"))))
def test_values_are_as_the_page_says(number: int) -> None:
    node, said = items("values")[number]
    assert compute(read_data(node), KNOWN) == json.loads(said)


def test_effects_are_read() -> None:
    for node, _ in items("effects"):
        assert read_effects(node)


def test_every_command_and_every_operator_is_on_the_page() -> None:
    coded = set(re.findall(r"`([^`\s]+)`", TEXT))
    assert COMMANDS.keys() <= coded
    assert OPERATORS.keys() | CHANGING <= coded


def test_the_world_of_the_mall_guide_is_proved() -> None:
    world = read_world(ROOT / "domains" / "mall_guide" / "plans" / "world.yaml")
    assert {name: Program.of(plan).machine.plan.calls != () for name, plan in world.plans.items()} == {"guide": True, "greet": True}
