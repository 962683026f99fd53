"""PDDL that is refused, with its position; and the lists of words that it is read from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest
from hypothesis import given, strategies as st

from planner_bridge.pddl import parse_domain, parse_problem, read_domain
from planner_bridge.pddl.expressions import MAX_DEPTH, Atom, Group, Node, parse, where
from pnm.errors import InputError
from tests.support.files import refused
from tests.support.pddl.text import EXTENDED, SMALL, Texts

BAD_INPUT = Path(__file__).with_name("refused")
Reader: TypeAlias = Callable[[str], object]


def in_domain(texts: Texts) -> Reader:
    return lambda text: parse_domain(f"{texts.domain}\n{text})")


def in_problem(texts: Texts) -> Reader:
    return lambda text: parse_problem(f"{texts.problem}\n{text})", parse_domain(f"{texts.domain})"))


READERS: dict[str, tuple[str, Reader]] = {
    "lists": ("", lambda text: parse(text, "f")),
    "whole": ("domain.pddl:", parse_domain),
    **{name: ("domain.pddl:", in_domain(SMALL)) for name in ("not_supported", "declarations", "actions")},
    "extensions": ("domain.pddl:", in_domain(EXTENDED)),
    "problems": ("problem.pddl:", in_problem(SMALL)),
    "extensions_in_problems": ("problem.pddl:", in_problem(EXTENDED)),
}
"""What the cases of each file are: the file that is named in the messages, and how they are read."""
DEEP, TOO_DEEP = "(" * 20_000, f"1:{MAX_DEPTH + 1}: nested deeper than {MAX_DEPTH} lists"
CASES = [
    *((name, *case.values) for name in READERS for case in refused(BAD_INPUT / f"{name}.pddl")),
    ("whole", "", "1:1: the file is empty; expected (define (domain NAME) ...)"),
    ("whole", DEEP, TOO_DEEP),
    ("lists", DEEP + ")" * 20_000, f"f:{TOO_DEEP}"),
]


@pytest.mark.parametrize(("cases", "text", "message"), CASES)
def test_what_is_wrong_is_refused_with_its_position(cases: str, text: str, message: str) -> None:
    file, read = READERS[cases]
    with pytest.raises(InputError) as caught:
        read(text)
    assert str(caught.value) == f"{file}{message}"


def test_a_domain_is_no_problem() -> None:
    with pytest.raises(InputError, match=r"1:9: expected \(problem NAME\), found \(domain \.\.\.\); this file is not a problem"):
        parse_problem("(define (domain d))", SMALL.domain_with(""))


def test_files_that_cannot_be_read_are_refused_at_their_beginning(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("")
    (tmp_path / "zeros").write_bytes(b"(define\0)")
    (tmp_path / "bytes").write_bytes(b"(define (domain d) (:types \xff))")
    (tmp_path / "sixteen").write_bytes(b"\xff\xfe(")
    (tmp_path / "zeros16").write_bytes("(define\0)".encode("utf-16"))
    for name, message in {
        "missing": " there is no such file",
        "": " this is a folder; expected a file",
        "empty": "1:1: the file is empty; expected (define (domain NAME) ...)",
        "zeros": "1:1: not a text file: it contains zero bytes",
        "bytes": "1:28: '\u00ff' cannot name a type; expected letters, digits and _ - . @",
        "sixteen": "1:1: not a text file: it begins as UTF-16 does and is none",
        "zeros16": "1:1: not a text file: it contains zero characters",
    }.items():
        with pytest.raises(InputError) as caught:
            read_domain(tmp_path / name)
        assert str(caught.value) == f"{tmp_path / name}:{message}"


# --- lists of words ---


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
