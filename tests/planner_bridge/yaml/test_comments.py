"""Comments are kept on the way from PDDL to YAML and back."""

from __future__ import annotations

from planner_bridge.pddl import parse_domain, write_domain
from planner_bridge.pddl.comments import Note
from planner_bridge.pddl.reader import comments
from planner_bridge.yaml.reader import parse
from planner_bridge.yaml.writer import write_domain as domain_as_yaml
from tests.support.yaml.conversion import comments_in, notes

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
