"""Lists of words: what is refused and where, then what is read."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from planner_bridge.pddl.expressions import MAX_DEPTH, Atom, Group, Node, parse, where
from pnm.errors import InputError
from tests.support.files import input_error, refused

BAD_INPUT = Path(__file__).with_name("refused")

BAD = [
    *refused(BAD_INPUT / "lists.pddl"),
    ("(" * 20_000, f"f:1:{MAX_DEPTH + 1}: nested deeper than {MAX_DEPTH} lists"),
    ("(" * 20_000 + ")" * 20_000, f"f:1:{MAX_DEPTH + 1}: nested deeper than {MAX_DEPTH} lists"),
]


@pytest.mark.parametrize(("text", "message"), BAD)
def test_refusals_say_where(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, "f")
    assert str(caught.value) == message


def test_words_and_lists() -> None:
    (whole,) = parse("(A ?c1 - aircraft?a; nothing (\n?x -t () -5.2e3\t3d)", "f")
    assert isinstance(whole, Group)
    assert whole.head == "a"
    assert [str(part) for part in whole.rest] == ["'?c1'", "'-'", "'aircraft'", "'?a'", "'?x'", "'-t'", "()", "'-5.2e3'", "'3d'"]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_positions_count_from_one_whatever_ends_a_line(end: str) -> None:
    nodes = parse(f"a ; comment{end}  (b{end}c)", "f")
    assert [str(where(node)) for node in nodes] == ["f:1:1", "f:2:3"]
    assert isinstance(nodes[1], Group)
    assert [str(where(node)) for node in nodes[1].items] == ["f:2:4", "f:3:1"]


WORDS = st.text(alphabet="ab1-_:=?", min_size=1, max_size=5).filter(lambda word: "?" not in word[1:] and word != "?")
TREES = st.recursive(WORDS, lambda inner: st.lists(inner, max_size=4), max_leaves=30)


def _written(tree: object) -> str:
    return f"({' '.join(map(_written, tree))})" if isinstance(tree, list) else str(tree)


def as_lists(node: Node) -> object:
    return node.text if isinstance(node, Atom) else [as_lists(part) for part in node.items]


@given(TREES)
def test_what_is_written_is_read(tree: object) -> None:
    (node,) = parse(_written(tree), "f")
    assert as_lists(node) == tree


@given(st.lists(TREES, max_size=4), st.sampled_from([" ", "\n", " ; ( ? )\n\t"]))
def test_every_part_stands_where_it_says(trees: list[object], space: str) -> None:
    text = space.join(map(_written, trees))
    lines = text.splitlines()
    for node in parse(text, "f"):
        position = where(node)
        begin = "(" if isinstance(node, Group) else node.text
        assert lines[position.line - 1][position.column - 1 :].startswith(begin)


@given(st.text(alphabet="()?;: \nab", max_size=60))
def test_any_text_is_read_or_refused_with_a_position(text: str) -> None:
    error = input_error(lambda: parse(text, "f"))
    assert error is None or error.position is not None
