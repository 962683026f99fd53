"""Damaged files: whatever a person does to a good file, it is read or refused with a place; nothing else is ever raised."""

from __future__ import annotations

from typing import Any

import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pnm.errors import InputError
from pnm.language.plan import parse_plans
from tests.pnm.language.test_domains import ORIGINAL, PDDL
from tests.pnm.language.test_execution import COUNTING, NESTED
from tests.pnm.language.test_plans import RECIPES, RECOVERING
from tests.support.runs.paper import PAPER_DOMAIN, PAPER_PLAN

GOOD = (COUNTING, NESTED, RECIPES, RECOVERING, f"{ORIGINAL}plan: [count: {{value: 1}}]\n")
WORDS = (
    *("and", "or", "not", "forall", "exists", "Query", "LocalUpdate", "Comparison", "Operation", "Literal", "Value", "when", "at_start"),
    *("variables", "condition", "effects", "while", "if", "then", "else", "plan", "actions", "after", "id", "recoveries", "during", "do"),
    *(
        "(at ?r ?x)",
        "(",
        ")",
        "()",
        "?",
        "?x",
        "(?x)",
        "(a (b))",
        "on",
        "eq",
        "=",
        "- ",
        "a - b",
        "(either",
        "",
        " ",
        "\n",
        "<<",
        "é",
        "\u2028",
    ),
)
scalars = st.none() | st.booleans() | st.integers(-3, 10**30) | st.floats() | st.sampled_from(WORDS) | st.text(max_size=5)
keys = st.sampled_from(WORDS)
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=2), max_leaves=4)
MARKS = (*WORDS, ":", "-", "[", "]", "{", "}", "'", '"', "&a ", "*a", "\t", "---\n", "...\n")


def places(tree: Any) -> list[tuple[Any, Any]]:
    """Every list or mapping in the tree, with an index or key of it."""
    keys = list(tree) if isinstance(tree, dict) else list(range(len(tree))) if isinstance(tree, list) else []
    return [place for key in keys for place in ((tree, key), *places(tree[key]))]


def damaged(data: st.DataObject, text: str) -> str:
    tree = yaml.safe_load(text)
    for _ in range(data.draw(st.integers(1, 3))):
        found = places(tree)
        if not found:
            break
        holder, key = data.draw(st.sampled_from(found))
        match data.draw(st.sampled_from(("replace", "remove", "rename", "wrap", "move"))):
            case "replace":
                holder[key] = data.draw(values)
            case "remove":
                del holder[key]
            case "rename" if isinstance(holder, dict):
                holder[data.draw(st.sampled_from(WORDS))] = holder.pop(key)
            case "wrap":
                holder[key] = data.draw(st.sampled_from(([holder[key]], {"and": holder[key]}, {"not": holder[key]})))
            case _:
                other, there = data.draw(st.sampled_from(found))
                if there in other if isinstance(other, dict) else there < len(other):
                    holder[key] = yaml.safe_load(yaml.safe_dump(other[there]))
    return yaml.safe_dump(tree, allow_unicode=True, sort_keys=False)


@given(st.data(), st.sampled_from(GOOD))
@settings(max_examples=300, deadline=None)
def test_damaged_trees_are_read_or_refused_with_a_place(data: st.DataObject, text: str) -> None:
    text = text.replace("<<: *rpn_action", "type: rpn_action").replace("<<: *ros_action", "type: ros_action")
    check(damaged(data, text.replace("<<: *kb_action", "type: kb_action")))


@given(st.data(), st.sampled_from((*GOOD, PDDL, PAPER_DOMAIN, PAPER_PLAN)))
@settings(max_examples=200, deadline=None)
@example(None, "...\n- not:\n a")  # type: ignore[arg-type]
def test_damaged_texts_are_read_or_refused_with_a_place(data: st.DataObject | None, text: str) -> None:
    for _ in range(3 if data else 0):
        assert data is not None
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.sampled_from(MARKS)) + text[end:]
    check(text)


def check(text: str) -> None:
    error = refused(text)
    assert error is None or (error.position is not None and str(error).startswith("F:")), error


def refused(text: str) -> InputError | None:
    try:
        parse_plans(text, "F")
    except InputError as error:
        return error
    return None
