"""Domains and problems in YAML that people write: read as PDDL, or refused with a position."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from planner_bridge.cli.convert import exported, imported
from planner_bridge.pddl import parse_domain
from planner_bridge.yaml.reader import parse
from planner_bridge.yaml.writer import write_domain as domain_as_yaml
from pnm.errors import InputError
from tests.support.files import refused
from tests.support.pddl.files import OWN

WRITTEN = """
name: d
types: robot place - object   # one text will do
constants: [r1 - robot, hall kitchen - place]
predicates: ["(at ?r - robot ?p - place)"]
functions: ["(battery ?r - robot)"]
actions:
  go:
    type: ros_action
    server: navigate
    params: [r - robot, from - place, to - place]
    preconditions:
      and:
        - Holds: (at ?r ?from)
        - LogicalNot: ["(at ?r ?to)"]
        - Comparison: ["ne", ["?from", "?to"]]
        - Comparison: [ge, [{Value: "(battery ?r)"}, Operation: [add, [1, 2]]]]
    effects:
      and:
        - (at ?r ?to)
        - not: {Holds: "(at ?r ?from)"}
        - decrease: ["(battery ?r)", 1]
plan:
  - go: {r: r1, from: hall, to: kitchen}
"""


def test_other_ways_to_write_it_are_read() -> None:
    found = parse(WRITTEN, "x.yaml").domain
    expected = parse_domain(
        "(define (domain d) (:requirements :typing) (:types robot place) (:constants r1 - robot hall kitchen - place)"
        " (:predicates (at ?r - robot ?p - place)) (:functions (battery ?r - robot))"
        " (:action go :parameters (?r - robot ?from ?to - place)"
        " :precondition (and (at ?r ?from) (not (at ?r ?to)) (not (= ?from ?to)) (>= (battery ?r) (+ 1 2)))"
        " :effect (and (at ?r ?to) (not (at ?r ?from)) (decrease (battery ?r) 1))))"
    )
    assert found == replace(expected, requirements=())
    assert [str(one) for one in found.warnings] == ["x.yaml:9:5: warning: 'type' of go is left out: PDDL has nothing like it"]


def test_requirements_that_are_missing_are_told_of_the_pddl_that_is_written(tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(WRITTEN, encoding="utf-8")
    found = imported(file)
    missing = [warning for warning in found.warnings if warning.message == ":typing is needed here but not among the :requirements"]
    assert [warning.position.file for warning in missing] == ["domain.pddl"]
    file.write_text(f"requirements: [typing, adl, fluents]\n{WRITTEN}", encoding="utf-8")
    assert not any("needed" in str(warning) for warning in imported(file).warnings)


def test_every_text_of_a_list_says_its_own_types() -> None:
    text = "types: [t]\nfunctions: [(f), (g) - t, (h)]\nconstants: [a, b - t, c]\nactions: {go: {params: [x, y - t, z]}}\n"
    found = parse(text, "x.yaml").domain
    assert [one.values for one in found.functions.values()] == [(), ("t",), ()]
    assert dict(found.constants) == {"a": ("object",), "b": ("t",), "c": ("object",)}
    assert [one.types for one in found.actions["go"].parameters] == [("object",), ("t",), ("object",)]


@pytest.mark.parametrize(("text", "message"), refused(Path(__file__).parent / "refused" / "converted.yaml"))
def test_what_is_wrong_is_said_where_it_is(text: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        parse(text, "x.yaml")
    assert str(refusal.value).startswith(message)


TYPED = """name: d
types: robot place
constants: [r1 - robot, hall - place]
predicates: ["(at ?r - robot ?p - place)", "(clean ?p - place)", (tidy)]
functions: ["(charge ?r - robot)", "(home ?r - robot) - place"]
derived: [{fact: (tidy), condition: {forall: {variables: "?p - place", condition: "(clean ?p)"}}}]
"""


@pytest.mark.parametrize(("text", "message"), refused(Path(__file__).parent / "refused" / "checked_by_types.yaml"))
def test_names_are_checked_as_planners_do(text: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        parse(f"{TYPED}{text}\n", "x.yaml")
    assert str(refusal.value).startswith(f"x.yaml:{message}")


def test_types_are_no_kinds_of_themselves() -> None:
    with pytest.raises(InputError, match=r"x.yaml:1:9: the type 'a' is a kind of itself"):
        parse("types: [a - b, b - a]\nactions: {}\n", "x.yaml")


def test_a_damaged_file_is_read_or_refused_with_a_position() -> None:
    text = exported(*OWN[0]).text
    for start in range(0, len(text), 97):
        try:
            parse(text[:start] + text[start + 13 :], "x.yaml")
        except InputError as error:
            assert error.position is not None  # noqa: PT017


def test_what_is_nested_too_deeply_is_refused() -> None:
    nested = "(or (p) " * 40 + "(p)" + ")" * 40
    domain = parse_domain(f"(define (domain d) (:predicates (p)) (:action a :parameters () :precondition {nested}))")
    with pytest.raises(InputError, match="nested too deeply"):
        domain_as_yaml(domain)
