"""PDDL text to models and back.

`syntax.expressions` → `read.sections` → `read.declarations`, `terms`, `formulas`, `actions`, ... → `read.reader`;
`write.writer` is the way back. Every error has file, line and column, what was found and what was expected.
`read.requirements` is the table of everything that is refused, or tolerated with a warning.
"""

from planner_bridge.pddl.read.reader import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.write.writer import write_domain, write_problem

__all__ = ["parse_domain", "parse_problem", "read_domain", "read_problem", "write_domain", "write_problem"]
