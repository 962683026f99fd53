"""PDDL text to models and back.

`sexpr` → `sections` → `declarations`, `scope`, `conditions`, `effects`, ... → `reader`; `writer` is the way back.
Errors say file, line and column, what was found and what was expected. What is not as it should be but can
be understood is read with a warning.
"""

from planner_bridge.pddl.read.reader import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.write.writer import write_domain, write_problem

__all__ = ["parse_domain", "parse_problem", "read_domain", "read_problem", "write_domain", "write_problem"]
