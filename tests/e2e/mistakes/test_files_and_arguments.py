"""Mistakes with files, what is in them, and arguments, as far as they are not in the tables of the readers (`refused`).

Mistakes in bindings that show only beside the ROS graph are in `tests/e2e/run/test_check.py`.
"""

from __future__ import annotations

from pathlib import Path

from tests.support.e2e.command_line import Mistake, mistakes, pnm

BOTH = "robots/domain.pddl robots/problem.pddl"

FILES = {
    "the folder is misspelt": Mistake(
        "plan robot/domain.pddl robots/problem.pddl", 2, ("robot/domain.pddl: there is no such file; did you mean 'robots/domain.pddl'?",)
    ),
    "the file of an option is misspelt": Mistake(f"run {BOTH} --bindings bindings.yml", 2, ("bindings.yml: there is no such file\n",)),
    "the file of the plan is misspelt": Mistake("run --plan tee.yaml", 2, ("tee.yaml: there is no such file; did you mean 'tea.yaml'?",)),
    "a folder for the file of an option": Mistake(f"run {BOTH} --faults robots", 2, ("robots: this is a folder; expected a file",)),
    "YAML for PDDL": Mistake(
        "plan tea.yaml tea.yaml", 2, ("tea.yaml:1:1: expected (define (domain NAME) ...), found 'actions:'", "this is YAML: `pnm import`")
    ),
    "a folder with a domain for the output of an import": Mistake(
        "import kitchen.yaml -o robots",
        2,
        ("robots/domain.pddl: already exists; use --force to overwrite it",),
        {"kitchen.yaml": "actions: {go: {params: [place]}}\n"},
    ),
}

ARGUMENTS = {
    "nothing to plan for": Mistake("plan robots/domain.pddl", 2, ("Usage: pnm plan", "Missing argument 'PROBLEM'")),
    "nothing to reach": Mistake("run robots/domain.pddl", 2, ("expected DOMAIN and PROBLEM, or --plan and a file",)),
    "a plan and a problem": Mistake(f"run {BOTH} --plan tea.yaml", 2, ("--plan replaces DOMAIN and PROBLEM; expected one or the other",)),
    "an option is misspelt": Mistake(f"plan {BOTH} --planer kairos", 2, ("No such option '--planer'", "'--planner'")),
    "a time-out, of what?": Mistake(f"run {BOTH} --timeout 5", 2, ("No such option '--timeout'", "'--planner-timeout'")),
    "a command is misspelt": Mistake(f"pln {BOTH}", 2, ("No such command 'pln'. Did you mean 'plan'?",)),
    "help for a command that is misspelt": Mistake("help pln", 2, ("No such command 'pln'. Did you mean 'plan'?",)),
    "a choice that is none": Mistake(f"run {BOTH} --actions ros", 2, ("'ros' is not one of 'simulated', 'ros2'",)),
    "the plan's file behind a flag": Mistake(f"export {BOTH} --plan foo.yaml", 2, ("No such option '--plan'", "'--with-plan'")),
    "sensing in a simulation": Mistake(f"run {BOTH} --sensing s.yaml", 2, ("--sensing describes topics", "expected --actions ros2")),
    "faults over ROS 2": Mistake(f"run {BOTH} --faults f.yaml --actions ros2", 2, ("--faults belongs to simulated robots",)),
    "parameters of a problem": Mistake(f"run {BOTH} --set guest=Ada", 2, ("--set", "belong to hand-written plans")),
    "answers of a problem": Mistake(f"run {BOTH} --answer drink=tea", 2, ("--answer", "belong to hand-written plans")),
    "no value": Mistake("run --plan tea.yaml --set guest", 2, ("expected NAME=VALUE after --set, found 'guest'",)),
    "a value that is missing": Mistake(
        "run --plan tea.yaml", 2, ("tea needs a value for its parameter 'guest'; expected {guest: …}", "(--set guest=…)")
    ),
    "a parameter is misspelt": Mistake("run --plan tea.yaml --set gest=Ada", 2, ("tea has no parameter 'gest'; did you mean 'guest'?",)),
    "a plan is misspelt": Mistake("run --plan tea.yaml --name tee", 2, ("there is no plan 'tee'; expected --name and one of tea",)),
}


def bindings(text: str, *says: str) -> Mistake:
    return Mistake(f"run {BOTH}", 2, says, {"robots/bindings.yaml": f"actions:\n  {text}\n"})


BINDINGS = {
    "a type as ROS 1 has it": bindings(
        "move: {type: nav2_msgs/NavigateToPose}",
        "bindings.yaml:2:16: expected a type such as nav2_msgs/action/NavigateToPose under 'type', found 'nav2_msgs/NavigateToPose'",
    ),
    "a server with a space": bindings("move: {server: go there}", "2:18: 'go there' cannot name an action server"),
    "too few spaces": bindings("move:\n  server: go", "3:3: 'server' belongs under an action: two more spaces before it"),
}


def pddl(file: str, before: str, after: str, *says: str, command: str = "plan", status: int = 2) -> Mistake:
    return Mistake(f"{command} {BOTH}", status, says, edits=((f"robots/{file}.pddl", before, after),))


PDDL = {
    "a ) is missing before an action": pddl(
        "domain", "(at end (at ?r ?to))))", "(at end (at ?r ?to)))", "domain.pddl:11:3: this '(' is not closed; expected ')' before line 16"
    ),
    "a goal of nothing at all": pddl("problem", "(holding r1 cup)", "()", "nothing to do: the goal is empty", status=0),
    "a number without a value, which is needed": pddl(
        "problem",
        "    (= (speed r1) 1)\n",
        "",
        "no plan: proved unsolvable: (holding r1 cup) cannot be reached: grasp(r1, cup, hall) would do it, but ",
        "needs (speed r1), which has no value",
        status=1,
    ),
    "a door that nothing opens, in a run": pddl(
        "problem",
        " (door_open)",
        "",
        "goal     not reached: no plan: proved unsolvable: (holding r1 cup) cannot be reached: grasp(r1, cup, hall) would do it, but ",
        "move(r1, dock, hall) needs (door_open), which is never true",
        command="run",
        status=1,
    ),
}

HEAD = """\
actions:
  go: {params: [place]}
  say: {params: [text]}
  stop: {params: []}
initial_knowledge: {name: Ada, served: 0}
plan:
"""
FEW = "{Comparison: [lt, [LocalQuery: served, 2]]}"


def steps(text: str, *says: str, status: int = 2) -> Mistake:
    return Mistake("run --plan plan.yaml", status, says, {"plan.yaml": f"{HEAD}{text}\n"})


PLANS = {
    "a value for nothing": steps("  - stop: hall", "7:11: expected the parameters of stop, found 'hall'; write '- stop:'"),
    "a list for the parameters": steps("  - go: [hall]", "7:9: expected the parameters of go, found a list; write '- go: {place: …}'"),
    "no colon before braces": steps("  - go {place: hall}", "7:5: expected ': ' after 'go', found 'go {place'"),
    "no dash": steps("  go: {place: hall}", "7:3: expected a list of steps, found a mapping; each begins with a dash and a space"),
    "a block is misspelt": steps("  - concurent_actions: [stop: ]", "7:5: there is no action", "did you mean 'concurrent_actions'?"),
    "a condition beside its loop": steps(
        f"  - while:\n    condition: {FEW}\n    actions: [stop: ]", "8:5: 'condition' belongs under 'while': two more spaces before it"
    ),
    "a condition under a choice": steps(
        f"  - if:\n      condition: {FEW}\n    then: [stop: ]", "8:7: 'condition' does not belong under 'if': 'if' has the condition itself"
    ),
    "the way under a choice": steps(
        "  - if:\n      then: [stop: ]\n      Comparison: [lt, [1, 2]]", "8:7: 'then' does not belong under 'if': it stands beside 'if'"
    ),
    "a sign that texts cannot begin with": steps("  - say: {text: @home}", "7:17: not YAML", "a text that begins with it needs quotes"),
    "a step that is indented otherwise": steps(
        "  - go: {place: hall}\n   - stop:", "8:4: not YAML", "its indentation differs from that of its neighbours"
    ),
    "a variable as other languages write it": steps(
        '  - say: {text: "Hello ${name}"}',
        "start  say(Hello ${name})",
        "plan.yaml:7:17: warning: '${name}' stays as it is written; ",
        "for the value of name write {Operation: [concat, [..., {LocalQuery: name}]]}",
        status=0,
    ),
    "a variable in braces": steps('  - say: {text: "Hello {name}"}', "warning: '{name}' stays as it is written", status=0),
    "a variable as bindings write it": steps(
        "  - say: {text: $name}", "warning: '$name' stays as it is written; for the value of name write {LocalQuery: name}", status=0
    ),
}


@mistakes(FILES | ARGUMENTS | BINDINGS | PDDL | PLANS)
def test_a_mistake_is_answered_with_what_to_write_instead(mistake: Mistake, tmp_path: Path) -> None:
    mistake.check(tmp_path)


ASKED = """\
actions: {bring: {params: [drink]}}
plan:
  - bring: {drink: {PersonQuery: first}}
  - while:
      condition: {Comparison: [ne, [{PersonQuery: next}, nothing]]}
      actions:
        - bring: {drink: {PersonQuery: first}}
"""


def test_people_who_are_not_there_are_answered_for(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(ASKED)
    answers = ("first=tea", "next=1", "next=[2]", "next=nothing", "nxt=3")
    done = pnm("run", "--plan", "plan.yaml", *(word for answer in answers for word in ("--answer", answer)), cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.count("start  bring(tea)") == 3
    assert done.stderr == "the answer to nxt was not needed\n"
