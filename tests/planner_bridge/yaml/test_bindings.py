"""Bindings are part of what is exported and imported: a plan that is exported calls the servers that the goal would have called."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from planner_bridge.cli.convert import exported, imported
from pnm.actions.bindings_file import read_bindings
from pnm.core.machine.bindings import DEFAULT, Binding, Bindings, Foreign, Found, Table, WhenLost
from pnm.core.message_fields import Combined, Comparison, FieldValue, Flag, parse_field
from pnm.errors import InputError
from pnm.language.plan import read_plans
from tests.support.e2e.command_line import pnm
from tests.support.files import ROOT, written

DELIVERY = ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl"
STATUS = parse_field("result.status")
NEITHER = Combined("not", (Combined("any", (Flag(parse_field("error")), Flag(parse_field("a[-1].b")))),))
EVERYTHING = Binding(
    server="/{robot}/move",
    type="nav2_msgs/action/NavigateToPose",
    success=Combined("all", (Comparison(STATUS, "eq", 0), NEITHER)),
    reason=FieldValue(STATUS, {"1": "no way"}),
    final=Comparison(STATUS, "ge", 4),
    goal={
        "at": Table("?to", {"hall": {"x": 1.5}, "on": "(distance ?from ?to)"}),
        "pose": "$pose",
        "to": "?to",
        "deep": {"list": [1, 2.5, True, None, "on"], "x": "(distance ?from ?to)"},
    },
    store={"time": "travel time"},
    found=Found(STATUS, ("door",), (("leads", "?found", "?from", "?to"),), 3, Table("?to", {"hall": ["d7", {"name": "d8"}]})),
    seconds=6.0,
    timeout=30.0,
    accept=3.5,
    cancel=1.0,
    retries=2,
    ask={"place": "Where to, {robot}?"},
    several_servers=True,
    resources=("{robot}/base", "lift"),
    foreign=Foreign.WAIT,
    when_lost=WhenLost.ASK,
)


def test_everything_is_everything() -> None:
    """No field is left as it is by default, so that no test here overlooks one."""
    assert [field.name for field in fields(Binding) if getattr(EVERYTHING, field.name) == getattr(DEFAULT, field.name)] == [
        "outcomes",  # which only actions with several can have
        "position",
    ]


@pytest.mark.parametrize("binding", [EVERYTHING, Binding(retries=0), Binding(timeout=5.0), Binding(several_servers=True)])
def test_what_is_exported_is_bound_as_the_domain_was_and_so_is_what_is_imported_from_it(tmp_path: Path, binding: Binding) -> None:
    file = written(tmp_path, exported(*DELIVERY, with_plan=True, bindings=Bindings({"move": binding})).text)
    (plan,) = read_plans(file).values()
    assert plan.bindings.of("move") == binding
    file.write_text(exported(*DELIVERY, bindings=Bindings({"move": binding})).text, encoding="utf-8")
    found = imported(file)
    assert not found.warnings
    (tmp_path / "bindings.yaml").write_text(found.texts["bindings.yaml"], encoding="utf-8")
    assert read_bindings(tmp_path / "bindings.yaml").of("move") == binding
    assert read_bindings(tmp_path / "bindings.yaml").of("load") == DEFAULT


def test_the_command_exports_the_bindings_beside_the_domain_and_says_what_has_no_place(tmp_path: Path) -> None:
    assert "    server: /{robot}/move\n    timeout: 30\n    retries: 1\n" in pnm("export", *map(str, DELIVERY)).stdout
    (tmp_path / "b.yaml").write_text("actions: {load: {server: /lift}}\nassumed: [at]\nlag: 0.5\n")
    done = pnm("export", *map(str, DELIVERY), "--bindings", str(tmp_path / "b.yaml"))
    assert "    server: /lift\n    retries: 1\n" in done.stdout
    assert "/{robot}/move" not in done.stdout
    assert done.stderr == "'assumed' and 'lag' of the bindings are not in the text: give --bindings when it is run\n"


def test_a_binding_of_an_action_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match=r"the bindings have an action 'mvoe', which is not in .*; did you mean 'move'\?"):
        exported(*DELIVERY, bindings=Bindings({"mvoe": Binding()}))


@pytest.mark.parametrize("word", ["while", "if", "then", "else", "sequence", "concurrent_actions"])
def test_an_action_that_is_called_as_a_word_of_the_language_is_not_exported(tmp_path: Path, word: str) -> None:
    domain = written(tmp_path / "d.pddl", f"(define (domain d) (:predicates (p)) (:action {word} :effect (p)))")
    with pytest.raises(InputError, match=f"^'{word}' is a word of the language; expected another name for the action in the domain$"):
        exported(domain, None)


def plan_with(tmp_path: Path, action: str, init: str = "") -> tuple[Path, Path]:
    """A problem that an action of the domain solves, and one after it."""
    head = "(define (domain d) (:requirements :durative-actions :timed-initial-literals) (:predicates (p) (q) (open))"
    domain = written(tmp_path / "d.pddl", f"{head} {action} (:action b :parameters () :precondition (p) :effect (q)))")
    return domain, written(tmp_path / "p.pddl", f"(define (problem p) (:domain d) (:init {init}) (:goal (q)))")


@pytest.mark.parametrize("word", ["id", "after", "release", "timeout", "plan"])
def test_a_plan_with_an_action_that_is_called_as_an_option_of_steps_is_read_as_it_is_exported(tmp_path: Path, word: str) -> None:
    text = exported(*plan_with(tmp_path, f"(:action {word} :parameters () :effect (p))"), with_plan=True).text
    (plan,) = read_plans(written(tmp_path, text)).values()
    assert [call.action.name for call in plan.graph.calls] == [word, "b"]


def test_a_plan_that_needs_the_option_that_an_action_is_called_as_is_not_exported(tmp_path: Path) -> None:
    release = "(:durative-action release :parameters () :duration (= ?duration 1) :condition (at start (open)) :effect (at end (p)))"
    command = ["export", *map(str, plan_with(tmp_path, release, "(at 5 (open))")), "--with-plan", "-o", str(tmp_path / "x.yaml")]
    done = pnm(*command)
    assert (done.returncode, (tmp_path / "x.yaml").exists()) == (2, False)
    assert done.stderr == "this plan needs 'release' as a word of the language; an action cannot be called so, expected another name\n"
