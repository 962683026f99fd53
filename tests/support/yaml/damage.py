"""What a person may do to a good YAML file."""

from __future__ import annotations

from typing import Any

import yaml
from hypothesis import strategies as st

WORDS = (
    *("and", "or", "not", "forall", "exists", "Query", "LocalUpdate", "Comparison", "Operation", "Literal", "Value", "when", "at_start"),
    *("variables", "condition", "effects", "while", "if", "then", "else", "plan", "actions", "after", "id", "recoveries", "during", "do"),
    *("(at ?r ?x)", "(", ")", "()", "?", "?x", "(?x)", "(a (b))", "on", "eq", "=", "- ", "a - b", "(either"),
    *("", " ", "\n", "<<", "é", "\u2028"),
)


scalars = st.none() | st.booleans() | st.integers(-3, 10**30) | st.floats() | st.sampled_from(WORDS) | st.text(max_size=5)
keys = st.sampled_from(WORDS)
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=2), max_leaves=4)


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
