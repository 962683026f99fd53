"""PDDL that is refused, with its position."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pddl import parse_domain, parse_problem, read_domain
from planner_bridge.pddl.expressions import MAX_DEPTH
from pnm.errors import InputError
from tests.support.files import refused
from tests.support.pddl.text import EXTENDED, SMALL, Texts

BAD_INPUT = Path(__file__).with_name("refused")
DOMAINS = [
    *refused(BAD_INPUT / "whole.pddl"),
    ("", "1:1: the file is empty; expected (define (domain NAME) ...)"),
    ("(" * 20_000, f"1:{MAX_DEPTH + 1}: nested deeper than {MAX_DEPTH} lists"),
]


@pytest.mark.parametrize(("text", "message"), DOMAINS)
def test_a_text_that_is_no_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_domain(text)
    assert str(caught.value) == f"domain.pddl:{message}"


ADDED = {"not_supported": SMALL, "declarations": SMALL, "actions": SMALL, "extensions": EXTENDED}
"""To what the cases of each file are added."""


@pytest.mark.parametrize(
    ("file", "text", "message"), [(name, *case.values) for name in ADDED for case in refused(BAD_INPUT / f"{name}.pddl")]
)
def test_a_bad_domain_is_refused(file: str, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_domain(f"{ADDED[file].domain}\n{text})")
    assert str(caught.value) == f"domain.pddl:{message}"


@pytest.mark.parametrize(
    ("texts", "text", "message"),
    [
        (texts, *case.values)
        for file, texts in (("problems", SMALL), ("extensions_in_problems", EXTENDED))
        for case in refused(BAD_INPUT / f"{file}.pddl")
    ],
)
def test_a_bad_problem_is_refused(texts: Texts, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_problem(f"{texts.problem}\n{text})", parse_domain(f"{texts.domain})"))
    assert str(caught.value) == f"problem.pddl:{message}"


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
