"""PDDL ↔ YAML: models, their comments and plans as files of the language that people write, and back.

`writer` → `emitter` writes. `reader` reads: the model by `pnm.language`, and what only planners need.
"""
