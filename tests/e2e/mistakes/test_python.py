"""Mistakes in Python: arguments of another kind than expected are refused by name, before anything starts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest

from planner_bridge import Settings, achieve, load, plan_graph, read_domain, solve
from pnm import InputError, generate, verify
from tests.support.files import ROOT

FILES: Final = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))
DELIVERY: Final = load(*FILES)

MISTAKES: Final[dict[str, tuple[Callable[[], object], str]]] = {
    "actions that are misspelt": (lambda: achieve(*FILES, actions="ros"), "did you mean 'ros2'?"),
    "actions that are a function": (lambda: achieve(*FILES, actions=print), "or an ActionClient, found <built-in function print>"),
    "bindings that are a file": (
        lambda: Settings(bindings="bindings.yaml"),
        "expected Bindings, found 'bindings.yaml'; `pnm.read_bindings` reads a file",
    ),
    "no problem": (lambda: achieve(FILES[0], None), "expected a file, a Problem or a Problem of unified-planning for problem, found None"),
    "no domain": (lambda: achieve(None, FILES[1]), "expected a file or a Domain for domain, found None"),
    "texts for files": (
        lambda: achieve("(define (domain d)\n)", "(define (problem p)\n)"),
        "expected the name of a file for domain, found a text; `parse_domain` reads one",
    ),
    "a text for the problem": (lambda: load(FILES[0], "(define (problem p)\n)"), "for problem, found a text; `parse_problem` reads one"),
    "a file that is misspelt": (lambda: load(FILES[0].replace("delivery", "delivry"), FILES[1]), f"did you mean '{FILES[0]}'?"),
    "a text for a file that is not there": (lambda: read_domain("no.pddl"), "no.pddl: there is no such file"),
    "a file to solve": (lambda: solve("problem.pddl"), "solve: expected Problem for problem, found 'problem.pddl'"),
    "arguments in another order": (
        lambda: plan_graph(solve(DELIVERY).plan, DELIVERY),
        "plan_graph: expected Problem for problem, found a Plan",
    ),
    "an answer for a plan": (lambda: plan_graph(DELIVERY, solve(DELIVERY)), "plan_graph: expected Plan for plan, found a PlanningResult"),
    "a problem for a plan": (lambda: generate(DELIVERY), "generate: expected PlanGraph for plan, found <Problem delivery-p01"),
    "a plan for a machine": (lambda: verify(DELIVERY), "verify: expected PetriNetMachine for machine, found <Problem delivery-p01"),
}


@pytest.mark.parametrize(("mistake", "says"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_in_python(mistake: Callable[[], Any], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        mistake()
    assert says in str(caught.value)
    assert len(str(caught.value)) < 300
