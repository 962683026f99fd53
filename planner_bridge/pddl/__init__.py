"""PDDL text to models and back.

`expressions` → `sections` → `symbols`, `formulas`, `actions` → `reader`; `writer` is the way back.
Every error has file, line and column, what was found and what was expected.
`sections` has the table of everything that is refused, or tolerated with a warning.
"""

from planner_bridge.pddl.reader import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.writer import write_domain, write_problem

__all__ = ["parse_domain", "parse_problem", "read_domain", "read_problem", "write_domain", "write_problem"]
