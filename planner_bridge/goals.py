"""What a text means as a goal: a condition in PDDL, the name of a goal, or nothing for the problem's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from planner_bridge.model import Problem
from planner_bridge.pddl.goals import parse_condition
from pnm.conditions import Condition
from pnm.errors import InputError
from pnm.nearest import meant
from pnm.yaml_files import load_yaml


@dataclass(frozen=True)
class Goals:
    """The goals of a problem, of which some have names."""

    problem: Problem
    named: Mapping[str, Condition] = field(default_factory=dict)

    def read(self, text: str) -> Condition:
        """Return the goal that is meant.

        Raises:
            InputError: it is no condition, or nobody has given a goal this name.
        """
        text = text.strip()
        if not text:
            return self.problem.goal
        if text.startswith("("):
            return parse_condition(text, self.problem)
        if text not in self.named:
            hint = meant(text, self.named) or f"expected a condition such as (at r1 kitchen){self._names()}"
            raise InputError(f"there is no goal {text!r}; {hint}")
        return self.named[text]

    def _names(self) -> str:
        return f", or one of {', '.join(self.named)}" if self.named else ""


def read_goals(path: Path, problem: Problem) -> Goals:
    """Read a YAML file with goals by name: each a condition in PDDL.

    Raises:
        InputError: the file cannot be read, or a goal is no condition about the problem.
    """
    top = load_yaml(path)
    named: dict[str, Condition] = {}
    for name in top.nodes:
        text = top.string(name)
        if text is None or not text.strip().startswith("(") or name.startswith("("):
            raise InputError(f"expected a condition in PDDL as the goal {name!r}, such as (at r1 kitchen)", top.position(name))
        try:
            named[name] = parse_condition(text, problem, str(path))
        except InputError as error:
            raise InputError(f"in the goal {name!r}: {error.message}", top.position(name)) from error
    return Goals(problem, named)
