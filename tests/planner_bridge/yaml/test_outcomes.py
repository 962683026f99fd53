"""Outcomes of actions in YAML: as people write them, as `pnm export` does, and back to PDDL."""

from __future__ import annotations

from pathlib import Path

from planner_bridge.cli.convert import exported, imported
from planner_bridge.pddl import read_domain
from planner_bridge.yaml.reader import parse
from planner_bridge.yaml.writer import write_domain
from pnm.actions.bindings_file import read_bindings
from pnm.core.logic.effects import Alternative, OneOf, Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.message_fields import Combined, Comparison, parse_field
from pnm.language.plan import read_plans
from tests.support.files import written

PDDL = """(define (domain d)
  (:requirements :adl :durative-actions :non-deterministic :probabilistic-effects)
  (:predicates
    (held) (broken) (wet) (seen))
  ; to take it
  (:action pick
    :parameters ()
    :effect (and
      (seen)
      ; how it ends
      (probabilistic
        0.7 (held) ; in the hand
        0.3 (and (broken) (wet)))))
  (:action look
    :parameters ()
    :effect (and (oneof (and) (when (held) (oneof (seen) (wet)))) (broken)))
  (:durative-action drop
    :parameters ()
    :duration (= ?duration 3)
    :condition (at start (held))
    :effect (and (at start (not (held))) (at end (oneof (broken) (and))))))
"""
YAML = """name: d
requirements: [adl, durative-actions, non-deterministic, probabilistic-effects]

predicates:
  - (held)
  - (broken)
  - (wet)
  - (seen)

actions:
  # to take it
  pick:
    effects:
      - (seen)
    # how it ends
    outcomes:
      - chance: 0.7
        effects:
          - (held)  # in the hand
      - chance: 0.3
        effects:
          - (broken)
          - (wet)

  look:
    effects:
      - one_of:
          - effects: []
          - effects:
              - when:
                  condition: (held)
                  effects:
                    - one_of:
                        - effects:
                            - (seen)
                        - effects:
                            - (wet)
      - (broken)

  drop:
    duration: 3
    preconditions:
      at_start: (held)
    effects:
      at_start:
        - not: (held)
    outcomes:
      - effects:
          - (broken)
      - effects: []
"""


def test_outcomes_are_exported_and_come_back(tmp_path: Path) -> None:
    domain = written(tmp_path / "d.pddl", PDDL)
    assert exported(domain, None).text == YAML
    found = imported(written(tmp_path / "d.yaml", YAML))
    assert not found.warnings
    assert read_domain(written(tmp_path / "again.pddl", found.texts["domain.pddl"])) == read_domain(domain)
    assert all(comment in found.texts["domain.pddl"] for comment in ("; to take it", "; how it ends", "; in the hand"))


def test_names_are_kept_in_yaml_and_become_numbers_in_pddl(tmp_path: Path) -> None:
    code = parse_field("code")
    text = """name: d
predicates:
  - (held)
actions:
  pick:
    outcomes:
      - {name: held, chance: 0.5, effects: [(held)]}
      - {name: missed, chance: 0.3}
      - {name: slipped, chance: 0.2, effects: []}
    told_by:
      held: {field: code, eq: 0}
      missed: {field: code, eq: 1}
      slipped: {field: code, eq: 2}
"""
    contents = parse(text, "d.yaml")
    held = Set(("held",), Constant(True))
    alternatives = (Alternative((held,), 0.5, "held"), Alternative((), 0.3, "missed"), Alternative((), 0.2, "slipped"))
    assert contents.domain.actions["pick"].end_effects == (OneOf(alternatives),)
    assert contents.bindings.of("pick").outcomes["slipped"] == Comparison(code, "eq", 2)
    again = parse(write_domain(contents.domain, bindings=contents.bindings), "d.yaml")
    assert (again.domain, again.bindings) == (contents.domain, contents.bindings)
    found = imported(written(tmp_path / "d.yaml", text))
    assert [str(warning).partition(".yaml:")[2] for warning in found.warnings[:1]] == [
        "7:7: warning: 'name' of outcomes of pick is left out: PDDL has nothing like it"
    ]
    assert "(probabilistic 0.5 (held) 0.3 (and) 0.2 (and))" in found.texts["domain.pddl"]
    bindings = read_bindings(written(tmp_path / "b.yaml", found.texts["bindings.yaml"]))
    both = Combined("any", (Comparison(code, "eq", 1), Comparison(code, "eq", 2)))
    assert bindings.of("pick").outcomes == {"1": Comparison(code, "eq", 0), "2": both}


def test_an_exported_plan_says_which_outcome_it_expects(tmp_path: Path) -> None:
    domain = written(tmp_path / "d.pddl", PDDL)
    problem = written(tmp_path / "p.pddl", "(define (problem p) (:domain d) (:goal (wet)))")
    text = exported(domain, problem, with_plan=True, bindings=Bindings({"pick": Binding(timeout=9.0)})).text
    (plan,) = read_plans(written(tmp_path / "p.yaml", text)).values()
    assert [(call.action.name, call.action.outcome) for call in plan.graph.calls] == [("pick", "2")]
    assert [way.chance for way in plan.graph.calls[0].action.outcomes] == [0.7, 0.3]
    assert plan.graph.calls[0].action.end_effects == plan.graph.calls[0].action.outcomes[1].effects
