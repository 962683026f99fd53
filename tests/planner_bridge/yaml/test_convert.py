"""PDDL ↔ YAML: nothing is lost on the way there and back, comments included, and what is wrong is said where it is."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem, write_domain
from planner_bridge.pddl.comments.table import Note, Table
from planner_bridge.pddl.read.attach_comments import comments
from planner_bridge.pddl.syntax.expressions import tokens
from planner_bridge.yaml.convert import exported, imported
from planner_bridge.yaml.emitter import Entry, Mapping, Sequence, document, scalar
from planner_bridge.yaml.reader import parse
from planner_bridge.yaml.write_domain import write_domain as domain_as_yaml
from planner_bridge.yaml.write_domain import write_problem as problem_as_yaml
from pnm.core.logic.conditions import All, Compare, Holds
from pnm.core.logic.domain import ActionSchema, Preference
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Constant, Fluent, ValueOf
from pnm.core.logic.rules import DerivationRule
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError
from tests.support.files import ROOT, SHARED
from tests.support.pddl import models as pddl
from tests.support.pddl import random_problems as generated
from tests.support.pddl.files import REFUSED
from tests.support.refusals import refused

PAIRS = SHARED / "pddl"
GOLDEN = ROOT / "tests" / "planner_bridge" / "yaml" / "golden" / "patrol.yaml"
PATROL = (ROOT / "domains/patrol/domain.pddl", ROOT / "problems/patrol/p01.pddl")
OWN = [(path.parents[2] / "domains" / path.parent.name / "domain.pddl", path) for path in sorted((ROOT / "problems").glob("*/*.pddl"))]
OTHERS = [
    (folder / "domain.pddl", folder / "problem.pddl")
    for folder in sorted(path.parent for path in PAIRS.glob("*/*/domain.pddl"))
    if folder.name not in REFUSED
]


def told(table: Table) -> list[str]:
    return sorted(one for note in table.values() for one in (*note.before, *note.beside, *note.below) if one)


def comments_in(text: str) -> list[str]:
    return sorted(token.rstrip() for token, _ in tokens(text) if token[0] == ";")


def there_and_back(problem: Problem, table: Table) -> None:
    text = problem_as_yaml(problem, table)
    found = parse(text, "x.yaml")
    assert found.problem == problem
    assert found.domain == problem.domain
    assert told(found.comments) == told(table)
    assert problem_as_yaml(problem, found.comments) == text
    yaml.safe_load(text)


# --- files ---------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", [*OWN, *OTHERS], ids=lambda pair: f"{pair[0].parent.name}-{pair[1].stem}")
def test_pairs_come_back_with_all_of_their_comments(pair: tuple[Path, Path]) -> None:
    texts = [path.read_text(encoding="utf-8") for path in pair]
    problem = parse_problem(texts[1], parse_domain(texts[0]))
    tables = comments(texts[0], "domain"), comments(texts[1], "problem")
    assert [told(table) for table in tables] == [comments_in(text) for text in texts]
    there_and_back(problem, {**tables[0], **tables[1]})


@pytest.mark.parametrize("pair", [*OWN, *OTHERS], ids=lambda pair: f"{pair[0].parent.name}-{pair[1].stem}")
def test_what_is_imported_is_what_was_exported(pair: tuple[Path, Path], tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(exported(*pair).text, encoding="utf-8")
    found = imported(file).texts
    texts = [path.read_text(encoding="utf-8") for path in pair]
    domain = parse_domain(found["domain.pddl"])
    problem = parse_problem(texts[1], parse_domain(texts[0]))
    assert domain == problem.domain
    assert parse_problem(found["problem.pddl"], domain) == problem
    assert [comments_in(text) for text in found.values()] == [comments_in(text) for text in texts]


@pytest.mark.parametrize("pair", OWN, ids=lambda pair: f"{pair[0].parent.name}-{pair[1].stem}")
def test_lines_are_not_too_long_for_people(pair: tuple[Path, Path]) -> None:
    assert max(len(line) for line in exported(*pair).text.splitlines() if "#" not in line) <= 100


def test_a_small_domain_looks_as_it_ever_did() -> None:
    assert exported(*PATROL).text == GOLDEN.read_text(encoding="utf-8")


def test_a_domain_alone() -> None:
    text = exported(PATROL[0], None).text
    assert "problem:" not in text
    assert parse(text, "x.yaml").domain == parse_domain(PATROL[0].read_text(encoding="utf-8"))


# --- laws ----------------------------------------------------------------------------------


def whole(domain: Domain) -> Domain:
    found = parse(domain_as_yaml(domain), "x.yaml")
    assert found.problem is None
    return found.domain


@settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    st.tuples(pddl.INSTANTANEOUS, pddl.DURATIVE),
    st.lists(pddl.RULES, max_size=2),
    st.lists(pddl.constraints(), max_size=2),
    st.lists(pddl.WISHES, max_size=2),
)
def test_a_domain_comes_back(
    actions: tuple[ActionSchema, ActionSchema], rules: list[DerivationRule], kept: list[Constraint], wished: list[Preference]
) -> None:
    domain = replace(
        pddl.domain_of(list(actions)),
        rules=tuple(rules),
        constraints=tuple(map(pddl.over, kept)),
        preferences=tuple(wished),
        hierarchy=("(:task t)", "(:method m\n    :parameters () ; why\n\t:task (t))"),
    )
    found = whole(domain)
    assert found == domain
    assert [list(part) for part in (found.types, found.actions)] == [list(part) for part in (domain.types, domain.actions)]


@settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    pddl.values(st.just(True)),
    pddl.TIMED,
    pddl.NUMBERS,
    st.lists(pddl.PREFERENCES, max_size=2),
    st.lists(pddl.constraints(), max_size=2),
    st.lists(pddl.WISHES, max_size=2),
)
def test_a_problem_comes_back(
    init: dict[Fluent, bool | float | str],
    timed: tuple[TimedChange, ...],
    number: float,
    goals: list[Preference],
    kept: list[Constraint],
    wished: list[Preference],
) -> None:
    goal = All((Holds(("idle",)), Compare(">", ValueOf(("charge", "r2")), Constant(number))))
    soft = (*(replace(one, variables=(*pddl.OWN, *one.variables)) for one in goals), *wished)
    problem = Problem(
        "p",
        pddl.domain_of([]),
        {"r2": ("robot",), "x": ("object",), "y": ("robot", "place")},
        init,
        timed,
        goal,
        None,
        tuple(map(pddl.over, kept)),
        tuple(sorted(soft, key=lambda one: isinstance(one.wanted, tuple))),
        network="(:htn :subtasks (and))\n(:tasks)",
        requirements=(":typing",),
    )
    there_and_back(problem, {})


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data(), st.booleans())
def test_generated_problems_come_back(data: st.DataObject, timed: bool) -> None:
    there_and_back(data.draw(generated.problems(generated.Features(timed=timed))), {})


NAMES = st.from_regex(r"[A-Za-z0-9_@.][A-Za-z0-9_@.-]*", fullmatch=True)
TEXTS = st.one_of(
    st.sampled_from(["on", "off", "Yes", "no", "y", "N", "null", "~", "1_000", "0o17", "12:30", "1e3", "=", "<<", "?x"]),
    st.sampled_from(["? x", "a: b", "a #b", "- a"]),
    NAMES,
    st.text(st.characters(exclude_categories=["Cs"]), max_size=12),
)


@given(TEXTS)
def test_every_reader_of_yaml_finds_the_exact_text(text: str) -> None:
    assert yaml.safe_load(f"- {scalar(text)}") == [text]
    assert yaml.safe_load(f"{scalar(text)}: 1") == {text: 1}
    assert yaml.safe_load(f"[{scalar(text, in_flow=True)}]") == [text]
    assert yaml.safe_load(f"{{{scalar(text, in_flow=True)}: {scalar(text, in_flow=True)}}}") == {text: text}


@given(st.lists(TEXTS.filter(str.strip), min_size=1, max_size=4), st.booleans())
def test_every_reader_of_yaml_finds_the_same_lists(texts: list[str], short: bool) -> None:
    entries = tuple([Entry(text, text) for text in dict.fromkeys(texts)])
    written = document(Mapping((Entry(Sequence(entries, short), "list"), Entry(Mapping(entries, short), "mapping"))))
    assert yaml.safe_load(written) == {"list": list(dict.fromkeys(texts)), "mapping": {text: text for text in texts}}


@pytest.mark.parametrize("name", ["on", "off", "yes", "No", "y", "n", "null", "true", "0x1F", "1_000", "2001-12-14", ".inf"])
def test_names_that_yaml_takes_for_something_else_are_quoted(name: str) -> None:
    domain = parse_domain(
        f"(define (domain {name}) (:requirements :typing :{name}) (:types {name}) (:predicates ({name} ?{name} - {name}))"
        f" (:action {name} :parameters (?{name} - {name}) :effect ({name} ?{name})))"
    )
    problem = parse_problem(
        f"(define (problem {name}) (:domain {name}) (:objects {name} - {name}) (:init ({name} {name})) (:goal (and)))", domain
    )
    there_and_back(problem, {})
    plain = yaml.safe_load(problem_as_yaml(problem))
    assert (plain["name"], list(plain["actions"]), plain["requirements"]) == (name, [name], ["typing", name.lower()])
    assert plain["problem"]["init"] == [f"({name} {name})"]


# --- comments ------------------------------------------------------------------------------

COMMENTED = """; about the file
(define (domain d) ; beside the name
  ; about the types
  (:types robot ; a robot
    ; above the place
    place) ; a place
  (:predicates
    (at ?r - robot ?p - place) ; where
                               ; it is
    (idle)
    ; (forgotten)
  )
  ; about the action

  (:action go ; beside the action
    ; about the parameters
    :parameters (?r - robot ?p - place)
    :precondition (and ; beside the precondition
      (idle) ; idle
      (or (idle) ; either
        ; or
        (not (at ?r ?p))))
    ; about the effect
    :effect (and (at ?r ?p)
      ; (not (idle))
    ))) ; no more
; the end
"""
COMMENTED_YAML = """# about the file
name: d  # beside the name

# about the types
types:
  - robot - object  # a robot
  # above the place
  - place - object  # a place

predicates:
  - (at ?r - robot ?p - place)  # where
                                # it is
  - (idle)
  # (forgotten)

actions:
  # about the action

  go:  # beside the action
    # about the parameters
    params: ?r - robot ?p - place
    preconditions:  # beside the precondition
      - (idle)  # idle
      - or:
          - (idle)  # either
          # or
          - not: (at ?r ?p)
    # about the effect
    effects:
      - (at ?r ?p)
      # (not (idle))
  # no more
  # the end
"""


def test_comments_stay_where_they_are() -> None:
    table = comments(COMMENTED, "domain")
    text = domain_as_yaml(parse_domain(COMMENTED), table)
    assert text == COMMENTED_YAML
    found = parse(text, "x.yaml")
    assert domain_as_yaml(found.domain, found.comments) == text
    assert comments_in(write_domain(found.domain, found.comments)) == comments_in(COMMENTED)
    assert write_domain(found.domain, found.comments) == write_domain(
        found.domain, comments(write_domain(found.domain, found.comments), "domain")
    )


def test_comments_about_nothing_that_is_written_stay_nearby() -> None:
    text = "(define (domain d) (:types ; none\n) (:action a :parameters () ; no parameters\n :precondition ()\n ; nothing\n))"
    written = domain_as_yaml(parse_domain(text), comments(text, "domain"))
    assert written == "name: d\n\ntypes: []  # none\n\nactions:\n  # no parameters\n  # nothing\n  a: {}\n"


def test_characters_that_yaml_does_not_allow_are_left_out_of_comments() -> None:
    text = "; a\x0cb\u2028c\x85d\n(define (domain d))"
    assert domain_as_yaml(parse_domain(text), comments(text, "domain")) == "# a b c d\nname: d\n"


def test_what_a_file_says_to_editors_is_no_comment() -> None:
    assert parse("# yaml-language-server: $schema=x.json\n# mine\nname: d\ntypes: []\n", "x.yaml").comments == {
        ("domain",): Note(before=("; mine",))
    }


def test_comments_inside_texts_are_no_comments() -> None:
    text = "(define (domain d) (:requirements :hierarchy) (:task t ; why\n :parameters ()) ; own\n)"
    domain = parse_domain(text)
    table = comments(text, "domain")
    assert told(table) == ["; own"]
    found = parse(domain_as_yaml(domain, table), "x.yaml")
    assert found.domain == domain
    assert told(found.comments) == ["; own"]


# --- what people write ---------------------------------------------------------------------

WRITTEN = (
    """
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
        - LogicalNot: [(at ?r ?to)]
        - Comparison: ["ne", ["?from", "?to"]]
        - Comparison: [ge, [{Value: (battery ?r)}, Operation: [add, [1, 2]]]]
    effects:
      and:
        - (at ?r ?to)
        - not: {Holds: (at ?r ?from)}
        - decrease: [(battery ?r), 1]
plan:
  - go: {r: r1, from: hall, to: kitchen}
""".replace("[(at ?r ?to)]", '["(at ?r ?to)"]')
    .replace("{Value: (battery ?r)}", '{Value: "(battery ?r)"}')
    .replace("{Holds: (at ?r ?from)}", '{Holds: "(at ?r ?from)"}')
    .replace("[(battery ?r), 1]", '["(battery ?r)", 1]')
)


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
    assert [str(one) for one in found.warnings] == [
        "x.yaml:9:5: warning: 'type' of go is left out: PDDL has nothing like it",
        "x.yaml:10:5: warning: 'server' of go is left out: PDDL has nothing like it",
    ]


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


HEAD = "name: d\npredicates: [(p), (q)]\n"


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


if __name__ == "__main__" and "--write" in sys.argv:
    GOLDEN.write_text(exported(*PATROL).text, encoding="utf-8")
