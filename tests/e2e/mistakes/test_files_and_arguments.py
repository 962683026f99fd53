"""Mistakes with files and arguments."""

from __future__ import annotations

from pathlib import Path

from tests.support.e2e.command_line import Mistake, mistakes

BOTH = "robots/domain.pddl robots/problem.pddl"

FILES = {
    "the folder is misspelt": Mistake(
        "plan robot/domain.pddl robots/problem.pddl",
        2,
        ("robot/domain.pddl: there is no such file; did you mean 'robots/domain.pddl'?",),
    ),
    "the file is misspelt": Mistake(
        "plan robots/domian.pddl robots/problem.pddl",
        2,
        ("robots/domian.pddl: there is no such file; did you mean 'robots/domain.pddl'?",),
    ),
    "the file of an option is misspelt": Mistake(f"run {BOTH} --bindings bindings.yml", 2, ("bindings.yml: there is no such file\n",)),
    "the file of the plan is misspelt": Mistake("run --plan tee.yaml", 2, ("tee.yaml: there is no such file; did you mean 'tea.yaml'?",)),
    "a folder for a file": Mistake("plan robots robots/problem.pddl", 2, ("robots: this is a folder; expected a file",)),
    "a folder for the file of an option": Mistake(f"run {BOTH} --faults robots", 2, ("robots: this is a folder; expected a file",)),
    "the problem first": Mistake(
        "plan robots/problem.pddl robots/domain.pddl",
        2,
        ("problem.pddl:1:9: expected (domain NAME), found (problem ...)", "the domain comes first, then the problem"),
    ),
    "the domain twice": Mistake(
        "plan robots/domain.pddl robots/domain.pddl", 2, ("domain.pddl:1:9: expected (problem NAME)", "this file is not a problem")
    ),
    "PDDL for a plan": Mistake("run --plan robots/domain.pddl", 2, ("robots/domain.pddl:1:1: this is PDDL; expected YAML",)),
    "PDDL for YAML to import": Mistake("import robots/domain.pddl -o new", 2, ("robots/domain.pddl:1:1: this is PDDL; expected YAML",)),
    "PDDL for bindings": Mistake(f"run {BOTH} --bindings robots/domain.pddl", 2, ("domain.pddl:1:1: this is PDDL; expected YAML",)),
    "YAML for PDDL": Mistake(
        "plan tea.yaml tea.yaml",
        2,
        ("tea.yaml:1:1: expected (define (domain NAME) ...), found 'actions:'", "this is YAML: `pnm import`"),
    ),
    "bindings for a plan": Mistake(
        "run --plan b.yaml", 2, ("b.yaml:1:1: there is no plan in the file; expected the key 'plan'",), {"b.yaml": "actions: {go: }\n"}
    ),
    "faults for bindings": Mistake(
        f"run {BOTH} --bindings f.yaml",
        2,
        ("f.yaml:1:1: unknown key 'faults'; expected one of actions, assumed, lag",),
        {"f.yaml": "faults: []"},
    ),
    "an empty file": Mistake(f"run {BOTH} --bindings e.yaml", 2, ("e.yaml:1:1: the file is empty",), {"e.yaml": ""}),
    "a folder that is not there for the output": Mistake(
        f"net {BOTH} -o nowhere/net.dot", 2, ("nowhere/net.dot: cannot be written: there is no folder nowhere",)
    ),
    "an input for the output": Mistake(
        f"export {BOTH} -o robots/domain.pddl", 2, ("robots/domain.pddl: already exists; use --force to overwrite it",)
    ),
    "a folder with a domain for the output of an import": Mistake(
        "import kitchen.yaml -o robots",
        2,
        ("robots/domain.pddl: already exists; use --force to overwrite it",),
        {"kitchen.yaml": "actions: {go: {params: [place]}}\n"},
    ),
    "several plans in the file to import": Mistake(
        "import errands.yaml -o new",
        0,
        ("errands.yaml:2:1: warning: 'there' is left out", "errands.yaml:3:1: warning: 'back' is left out", "wrote new/domain.pddl"),
        {"errands.yaml": "actions: {go: {params: '?to'}}\nthere: {plan: [go: {to: hall}]}\nback: {plan: [go: {to: dock}]}\n"},
    ),
}

ARGUMENTS = {
    "nothing to plan for": Mistake("plan robots/domain.pddl", 2, ("Usage: pnm plan", "Missing argument 'PROBLEM'")),
    "nothing to run": Mistake("run", 2, ("expected DOMAIN and PROBLEM, or --plan and a file",)),
    "nothing to reach": Mistake("run robots/domain.pddl", 2, ("expected DOMAIN and PROBLEM, or --plan and a file",)),
    "a plan and a problem": Mistake(f"run {BOTH} --plan tea.yaml", 2, ("--plan replaces DOMAIN and PROBLEM; expected one or the other",)),
    "an option is misspelt": Mistake(f"plan {BOTH} --planer kairos", 2, ("No such option '--planer'", "'--planner'")),
    "a time-out, of what?": Mistake(f"run {BOTH} --timeout 5", 2, ("No such option '--timeout'", "'--planner-timeout'")),
    "a command is misspelt": Mistake(f"pln {BOTH}", 2, ("No such command 'pln'. Did you mean 'plan'?",)),
    "help for a command that is misspelt": Mistake("help pln", 2, ("No such command 'pln'. Did you mean 'plan'?",)),
    "a choice that is none": Mistake(f"run {BOTH} --actions ros", 2, ("'ros' is not one of 'simulated', 'ros2'",)),
    "a planner is misspelt": Mistake(f"plan {BOTH} --planner kayros", 2, ("there is no planner 'kayros'", "did you mean 'kairos'?")),
    "a planner that cannot race": Mistake(
        f"plan {BOTH} --planner race:kairos,foo", 2, ("'foo' cannot take part in a race; these can: kairos, ",)
    ),
    "the plan's file behind a flag": Mistake(f"export {BOTH} --plan foo.yaml", 2, ("No such option '--plan'", "'--with-plan'")),
    "a plan without a problem": Mistake("export robots/domain.pddl --with-plan", 2, ("a plan is for a problem; expected its file",)),
    "sensing in a simulation": Mistake(f"run {BOTH} --sensing s.yaml", 2, ("--sensing describes topics", "expected --actions ros2")),
    "faults over ROS 2": Mistake(f"run {BOTH} --faults f.yaml --actions ros2", 2, ("--faults belongs to simulated robots",)),
    "parameters of a problem": Mistake(f"run {BOTH} --set guest=Ada", 2, ("--set", "belong to hand-written plans")),
    "answers of a problem": Mistake(f"run {BOTH} --answer drink=tea", 2, ("--answer", "belong to hand-written plans")),
    "no value": Mistake("run --plan tea.yaml --set guest", 2, ("expected NAME=VALUE after --set, found 'guest'",)),
    "no answer": Mistake("run --plan tea.yaml --answer drink", 2, ("expected NAME=VALUE after --answer, found 'drink'",)),
    "a value that is missing": Mistake(
        "run --plan tea.yaml", 2, ("tea needs a value for its parameter 'guest'; expected {guest: …}", "(--set guest=…)")
    ),
    "a parameter is misspelt": Mistake("run --plan tea.yaml --set gest=Ada", 2, ("tea has no parameter 'gest'; did you mean 'guest'?",)),
    "a plan is misspelt": Mistake("run --plan tea.yaml --name tee", 2, ("there is no plan 'tee'; expected --name and one of tea",)),
}


@mistakes(FILES | ARGUMENTS)
def test_a_mistake_with_files_or_arguments(mistake: Mistake, tmp_path: Path) -> None:
    mistake.check(tmp_path)
