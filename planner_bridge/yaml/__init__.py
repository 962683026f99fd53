"""PDDL ↔ YAML: models, their comments and plans as files of the language that people write, and back.

`formulas`, `domains`, `plans` → `emitter` write; `nodes` → `sections` → `reader` read, with the interpreters and the errors
of `planner_bridge.pddl`. `original` writes what the first implementation of Petri Net Machines loads.
"""
