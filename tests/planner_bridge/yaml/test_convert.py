"""PDDL ↔ YAML: nothing is lost on the way there and back, comments neither."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings, strategies as st

from planner_bridge.cli.convert import exported, imported
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem, write_domain
from planner_bridge.pddl.comments import CommentTable, Note
from planner_bridge.pddl.expressions import tokens
from planner_bridge.pddl.reader import comments
from planner_bridge.yaml.emitter import Entry, YamlList, YamlMapping, document, scalar
from planner_bridge.yaml.reader import parse
from planner_bridge.yaml.writer import write_domain as domain_as_yaml, write_problem as problem_as_yaml
from pnm.files.yaml_nodes import Mapped, Node
from tests.support.files import ROOT
from tests.support.pddl import random_problems as generated
from tests.support.pddl.files import OWN, REFUSED, Pair, name_of, pairs

GOLDEN = Path(__file__).parent / "golden" / "patrol.yaml"
PATROL = (ROOT / "domains/patrol/domain.pddl", ROOT / "problems/patrol/p01.pddl")
EVERY = [*OWN, *((folder / "domain.pddl", folder / "problem.pddl") for folder in pairs() if folder.name not in REFUSED)]


def notes(table: CommentTable) -> list[str]:
    return sorted(one for note in table.values() for one in (*note.before, *note.beside, *note.below) if one)


def comments_in(text: str) -> list[str]:
    return sorted(token.rstrip() for token, _ in tokens(text) if token[0] == ";")


def there_and_back(problem: Problem, table: CommentTable) -> None:
    text = problem_as_yaml(problem, table)
    found = parse(text, "x.yaml")
    assert found.problem == problem
    assert found.domain == problem.domain
    assert notes(found.comments) == notes(table)
    assert problem_as_yaml(problem, found.comments) == text
    yaml.safe_load(text)


# --- files ---


@pytest.mark.parametrize("pair", EVERY, ids=name_of)
def test_pairs_come_back_with_all_of_their_comments(pair: Pair, tmp_path: Path) -> None:
    texts = [path.read_text(encoding="utf-8") for path in pair]
    problem = parse_problem(texts[1], parse_domain(texts[0]))
    tables = comments(texts[0], "domain"), comments(texts[1], "problem")
    assert [notes(table) for table in tables] == [comments_in(text) for text in texts]
    there_and_back(problem, {**tables[0], **tables[1]})
    file = tmp_path / "x.yaml"
    file.write_text(exported(*pair).text, encoding="utf-8")
    if pair in OWN:
        assert max(len(line) for line in exported(*pair).text.splitlines() if "#" not in line) <= 100
    found = imported(file).texts
    domain = parse_domain(found["domain.pddl"])
    assert (domain, parse_problem(found["problem.pddl"], domain)) == (problem.domain, problem)
    assert [comments_in(text) for text in found.values()] == [comments_in(text) for text in texts]


def test_a_small_domain_looks_as_it_ever_did() -> None:
    assert exported(*PATROL).text == GOLDEN.read_text(encoding="utf-8")


def test_a_domain_alone() -> None:
    text = exported(PATROL[0], None).text
    assert "problem:" not in text
    assert parse(text, "x.yaml").domain == parse_domain(PATROL[0].read_text(encoding="utf-8"))


# --- laws ---


@settings(max_examples=20)
@given(st.data(), st.booleans())
def test_generated_problems_come_back(data: st.DataObject, timed: bool) -> None:
    there_and_back(data.draw(generated.problems(generated.Features(timed=timed, uncertain=True))), {})


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
    written = document(YamlMapping((Entry(YamlList(entries, short), "list"), Entry(YamlMapping(entries, short), "mapping"))))
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


def test_twice_the_actions_take_twice_the_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[object] = []
    mapped = Node.mapped

    def noted(node: Node) -> Mapped:
        read.append(node)
        return mapped(node)

    monkeypatch.setattr(Node, "mapped", noted)

    def mappings(actions: int) -> int:
        read.clear()
        parse("predicates: [(p)]\nactions:\n" + "".join([f"  a{number}: {{effects: [(p)]}}\n" for number in range(actions)]), "domain.yaml")
        return len(read)

    assert mappings(150) - mappings(100) == mappings(100) - mappings(50)


# --- comments ---


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
    assert notes(table) == ["; own"]
    found = parse(domain_as_yaml(domain, table), "x.yaml")
    assert found.domain == domain
    assert notes(found.comments) == ["; own"]


if __name__ == "__main__" and "--write" in sys.argv:
    GOLDEN.write_text(exported(*PATROL).text, encoding="utf-8")
