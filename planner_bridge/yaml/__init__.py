"""PDDL ↔ YAML: models, their comments and plans as files of the language that people write, and back.

`writer` and `write_plan` → `emitter` write. `reader` reads: the model by `pnm.language`, what only planners need by `read_constraints`.
"""
