"""Mistakes in bindings, as far as they are not in the tables of their reader (`tests/pnm/actions/refused`).

Those that show only beside the ROS graph are in `tests/e2e/run/test_check.py`.
"""

from __future__ import annotations

from pathlib import Path

from tests.support.e2e.command_line import Mistake, mistakes


def bindings(text: str, *says: str) -> Mistake:
    return Mistake("run robots/domain.pddl robots/problem.pddl", 2, says, {"robots/bindings.yaml": f"actions:\n  {text}\n"})


MISTAKES = {
    "an action is misspelt": bindings(
        "mvoe: {server: go}", "bindings.yaml:2:9: there is no action 'mvoe' in the domain; did you mean 'move'?"
    ),
    "a number in quotes": bindings(
        'move: {retries: "2"}', "2:19: expected a number of at least 0 under 'retries', found '2'; a number has no quotes"
    ),
    "a unit behind a number": bindings("move: {timeout: 10s}", "2:19: expected a number of at least 0 under 'timeout', found '10s'"),
    "braces without quotes": bindings(
        "move: {server: /{r}/move}", "2:19: not YAML", "inside braces and brackets a text with '{' needs quotes"
    ),
    "a parameter without quotes": bindings("move: {goal: {to: ?to}}", "2:21: not YAML", "inside braces and brackets a '?' needs quotes"),
    "a parameter that the action does not have": bindings(
        'move: {server: "/{robot}/move"}', "2:18: robot is not a parameter of move (r, from, to)"
    ),
    "a parameter is misspelt": bindings('move: {goal: {to: "?too"}}', "2:21: too is not a parameter of move (r, from, to)"),
    "a type without its package": bindings(
        "move: {type: NavigateToPose}", "2:16: expected a type such as nav2_msgs/action/NavigateToPose under 'type', found 'NavigateToPose'"
    ),
    "a type as ROS 1 has it": bindings(
        "move: {type: nav2_msgs/NavigateToPose}", "2:16: expected a type such as nav2_msgs/action/NavigateToPose"
    ),
    "a server with a space": bindings("move: {server: go there}", "2:18: 'go there' cannot name an action server"),
    "too few spaces": bindings("move:\n  server: go", "3:3: 'server' belongs under an action: two more spaces before it"),
    "a tab": bindings("move:\n\t  server: go", "3:1: not YAML", "indent with spaces, not with tabs"),
    "a key is misspelt": bindings("move: {sever: go}", "2:10: unknown key 'sever'; did you mean 'server'?"),
    "a key twice": bindings("move: {server: go, server: drive}", "2:22: the key 'server' is there twice"),
    "no action at all": Mistake(
        "run robots/domain.pddl robots/problem.pddl",
        2,
        ("bindings.yaml:1:1: unknown key 'move'; expected one of actions, assumed, lag",),
        {"robots/bindings.yaml": "move: {server: go}\n"},
    ),
}


@mistakes(MISTAKES)
def test_a_mistake_in_bindings(mistake: Mistake, tmp_path: Path) -> None:
    mistake.check(tmp_path)
