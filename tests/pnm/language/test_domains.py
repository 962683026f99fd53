"""Domains in YAML: kinds of actions, what is read of each, what PDDL declares, sources of knowledge; and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest

from pnm.core.logic.computed_values import Layer, Operation
from pnm.core.logic.conditions import TRUE, All, Compare, Computed, Holds, Not
from pnm.core.logic.effects import Set, TimedChange
from pnm.core.logic.expressions import DURATION, Constant, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule
from pnm.errors import InputError
from pnm.language import LanguageDomain, read_domain
from pnm.language.grammar import ActionKind
from tests.support.files import refused
from tests.support.yaml.examples import PDDL
from tests.support.yaml.formulas import q

BAD_INPUT = Path(__file__).with_name("refused")

Read: TypeAlias = Callable[[str], LanguageDomain]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read(text: str) -> LanguageDomain:
        path = tmp_path / "domain.yaml"
        path.write_text(text)
        return read_domain(path)

    return read


def test_kinds_may_be_named_or_left_out(read: Read) -> None:
    kinds = ("", "{type: rpn_action}", "{<<: *kb_action}", "{type: }", "{type: {module: any.thing, class: RPNAtomicAction}}")
    domain = read("actions:\n" + "".join(f"  {name}: {kind}\n" for name, kind in zip("abcde", kinds, strict=True)))
    words = [action.kind.value.removesuffix("_action") for action in domain.actions.values()]
    assert words == ["ros", "rpn", "kb", "ros", "rpn"]
    assert domain.actions["a"].is_open
    assert domain.actions["a"].binding.retries == 0


def test_what_pddl_has(read: Read) -> None:
    domain = read(PDDL)
    move = domain.actions["move"]
    assert move.schema.parameters == (Variable("?t", ("thing",)), Variable("?from", ("place",)), Variable("?to", ("place",)))
    assert move.schema.precondition == All((Holds(("at", "?t", "?from")), Not(Holds(("home", "?t")))))
    assert move.schema.invariant == Compare(">", ValueOf(("battery", "?t")), Constant(0.0))
    assert move.schema.end_condition == Holds(("free", "?t"))
    assert move.schema.start_effects == (Set(("at", "?t", "?from"), Constant(False)),)
    assert move.schema.end_effects == (Set(("at", "?t", "?to"), Constant(True)), Set(("battery", "?t"), ValueOf(DURATION), "decrease"))
    assert move.schema.expected == Computed(Operation("exists", (q("distance", Layer.ALL),)))
    assert move.resources == ("floor",)
    assert (move.binding.server, move.binding.type) == ("/{t}/move", "nav2_msgs/action/NavigateToPose")
    assert (move.binding.retries, move.binding.timeout) == (2, 30.0)
    assert move.binding.goal == {"to": "?to", "speed": 0.5}
    assert (move.binding.store, move.binding.ask) == ({"distance": "driven"}, {"speed": "How fast?"})
    assert move.objects == {"?t", "?from", "?to"}
    assert domain.model.domain.rules.rules == (DerivationRule("home", (Variable("?t", ("thing",)),), Holds(("at", "?t", "base"))),)
    assert domain.model.init == {("at", "r1", "k1"): True, ("battery", "r1"): 80.0, ("owner", "r1"): "r1", ("free", "r1"): False}
    assert domain.model.timed == (
        TimedChange(5.0, {("at", "r1", "k1"): False}),
        TimedChange(7.5, {("free", "r1"): True, ("battery", "r1"): 3.0}),
    )
    assert domain.model.goal == Holds(("home", "r1"))
    assert domain.model.objects_by_type == {
        "object": ("base", "r1", "k1", "k2"),
        "place": ("base", "k1", "k2"),
        "thing": ("r1",),
        "kitchen": ("k1", "k2"),
        "hall": ("base",),
        "robot": ("r1",),
        "drone": (),
    }


def test_objects_of_several_types_are_of_all_of_them(read: Read) -> None:
    domain = read("types: a b c - object\nconstants: x - (either a b)\nactions: {}\n")
    assert domain.model.objects_by_type == {"object": ("x",), "a": ("x",), "b": ("x",), "c": ()}


def test_types_that_are_kinds_of_each_other_do_not_trap(read: Read) -> None:
    assert read("types: [a - b, b - a]\nconstants: x - a\nactions: {}\n").model.objects_by_type["b"] == ("x",)


def test_what_is_tested_of_parameters_says_which_are_objects(read: Read) -> None:
    domain = read(
        """\
actions:
  act:
    params: [fact, "typed - t", compared, counted, quantified, effected, conditional]
    preconditions:
      - (p ?fact)
      - Comparison: [eq, ["?compared", fast]]
      - Comparison: ["<", [{Query: x}, "?counted"]]
      - forall: {variables: "?q", condition: "(p ?q ?quantified)"}
    effects:
      - when: {condition: "(p ?conditional)", effects: "(q ?effected)"}
"""
    )
    act = domain.actions["act"]
    assert act.objects == {"?fact", "?typed", "?quantified", "?effected", "?conditional"}
    assert act.mentioned == {"?fact", "?compared", "?counted", "?quantified", "?effected", "?conditional"}


def test_sources_of_knowledge_are_named_and_have_options(read: Read) -> None:
    domain = read("actions: {}\nknowledge: [terminal, {sqlite: {file: all.db}}, memory: ]\n")
    assert [(choice.name, choice.options) for choice in domain.sources] == [
        ("terminal", {}),
        ("sqlite", {"file": "all.db"}),
        ("memory", {}),
    ]
    assert [choice.name for choice in read("actions: {}\nknowledge: memory\n").sources] == ["memory"]
    assert read("actions: {}\n").sources == ()


@pytest.mark.parametrize("name", ["RPKnowledgeBase", "ROSExternalKnowledgeBase", "ExternalKnowledgeBase"])
def test_the_knowledge_bases_that_the_original_ships_are_known(read: Read, name: str) -> None:
    assert read(f"external_knowledge_base: {{module: any.thing, class: {name}}}\nactions: {{}}\n").sources[0].name == name


@pytest.mark.parametrize(("text", "message"), refused(BAD_INPUT / "domains.yaml"))
def test_what_is_wrong_with_a_domain(read: Read, tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read(text)
    assert str(caught.value).removeprefix(str(tmp_path / "domain.yaml")).startswith(message), str(caught.value)


def test_nothing_that_a_file_names_is_imported(read: Read, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "trap.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    for key in ("external_knowledge_base: {module: trap, class: C}\nactions: {}\n", "actions: {a: {type: {module: trap, class: C}}}\n"):
        with pytest.raises(InputError):
            read(key)
    kind = "actions: {a: {type: {module: trap, class: KBAction}}}\nexternal_knowledge_base: {module: trap, class: RPKnowledgeBase}\n"
    assert read(kind).actions["a"].kind is ActionKind.KB


def test_no_condition_is_one_that_always_holds(read: Read) -> None:
    domain = read("name: x\ntypes:\nconstants: []\nderived:\nproblem:\nactions: {a: {preconditions: , effects: {}}}")
    action = domain.actions["a"].schema
    assert (action.precondition, action.expected, action.end_effects, domain.model.goal) == (TRUE, TRUE, (), TRUE)


@pytest.mark.parametrize(
    ("part", "where"),
    [
        ("preconditions: {forall: {variables: '?x ?y ?z - t', condition: '(p ?x ?y ?z)'}}", ":3:23"),
        ("effects: {forall: {variables: '?x ?y - t', effects: {forall: {variables: '?z - t', effects: '(p ?x ?y ?z)'}}}}", ":3:17"),
        ("effects: [{when: {condition: {exists: {variables: '?x ?y ?z - t', condition: '(p ?x ?y ?z)'}}, effects: '(q)'}}]", ":3:37"),
    ],
)
def test_quantifiers_over_too_many_choices_are_refused_where_they_stand(read: Read, tmp_path: Path, part: str, where: str) -> None:
    for count, is_refused in ((20, False), (50, True)):
        text = f"types: t\nactions:\n  a: {{{part}}}\nproblem: {{objects: {' '.join(f'o{number}' for number in range(count))} - t}}\n"
        if not is_refused:
            assert "a" in read(text).actions
            continue
        with pytest.raises(InputError, match="the quantifiers range over 125000 choices of objects; expected 50000 at most") as caught:
            read(text)
        assert str(caught.value).removeprefix(str(tmp_path / "domain.yaml")).startswith(where), str(caught.value)
