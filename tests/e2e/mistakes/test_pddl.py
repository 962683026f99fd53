"""Mistakes in PDDL files, as far as they are not in the tables of the reader (`tests/planner_bridge/pddl/refused`)."""

from __future__ import annotations

from pathlib import Path

from tests.support.e2e.command_line import Mistake, mistakes

BOTH = "robots/domain.pddl robots/problem.pddl"
DOMAIN, PROBLEM = "robots/domain.pddl", "robots/problem.pddl"


def pddl(file: str, before: str, after: str, *says: str, command: str = "plan", status: int = 2) -> Mistake:
    return Mistake(f"{command} {BOTH}", status, says, edits=((file, before, after),))


MISTAKES = {
    "a ) is missing at the end": pddl(
        PROBLEM, "cup)))", "cup))", "problem.pddl:8:27: the text ends here; expected ')', for the '(' in line 1 is not closed"
    ),
    "a ) is missing in the last action": pddl(
        DOMAIN, "(holding ?r ?i)))))", "(holding ?r ?i))))", "domain.pddl:20:70: the text ends here; expected ')'"
    ),
    "a ) is missing before an action": pddl(
        DOMAIN, "(at end (at ?r ?to))))", "(at end (at ?r ?to)))", "domain.pddl:11:3: this '(' is not closed; expected ')' before line 16"
    ),
    "a ) is missing in a list": pddl(
        PROBLEM, "(= (speed r1) 1)", "(= (speed r1) 1", "problem.pddl:5:5: this '(' is not closed; expected ')' before line 6"
    ),
    "an object is not declared": pddl(
        PROBLEM, "(at r1 dock)", "(at r3 dock)", "problem.pddl:4:14: unknown object 'r3'; expected one of r1, r2"
    ),
    "a predicate is misspelt": pddl(PROBLEM, "(on cup", "(onn cup", "problem.pddl:4:37: unknown predicate 'onn'; did you mean 'on'?"),
    "no goal": pddl(PROBLEM, "  (:goal (holding r1 cup))", "", "problem.pddl:1:1: warning: there is no :goal; any state will do", status=0),
    "no goal to run for": pddl(PROBLEM, "  (:goal (holding r1 cup))", "", "there is no :goal; any state will do", command="run", status=0),
    "a goal of nothing": pddl(PROBLEM, "(holding r1 cup)", "(and)", "nothing to do: the goal is empty", status=0),
    "a goal of nothing at all": pddl(PROBLEM, "(holding r1 cup)", "()", "nothing to do: the goal is empty", status=0),
    "a number without a value": pddl(
        PROBLEM, "    (= (speed r2) 2)\n", "", "warning: (speed r2) has no value at first; actions that need it cannot be applied", status=0
    ),
    "a number without a value, which is needed": pddl(
        PROBLEM,
        "    (= (speed r1) 1)\n",
        "",
        "no plan: proved unsolvable: (holding r1 cup) cannot be reached: grasp(r1, cup, hall) would do it, but ",
        "needs (speed r1), which has no value",
        status=1,
    ),
    "a door that nothing opens": pddl(
        PROBLEM,
        " (door_open)",
        "",
        "no plan: proved unsolvable: (holding r1 cup) cannot be reached: grasp(r1, cup, hall) would do it, but ",
        "move(r1, dock, hall) needs (door_open), which is never true",
        status=1,
    ),
    "a door that nothing opens, in a run": pddl(
        PROBLEM,
        " (door_open)",
        "",
        "goal     not reached: no plan: proved unsolvable: (holding r1 cup) cannot be reached: grasp(r1, cup, hall) would do it, but ",
        "needs (door_open), which is never true",
        command="run",
        status=1,
    ),
}


@mistakes(MISTAKES)
def test_a_mistake_in_pddl(mistake: Mistake, tmp_path: Path) -> None:
    mistake.check(tmp_path)
