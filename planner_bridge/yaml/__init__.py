"""PDDL ↔ YAML: models, their comments and plans as files of the language that people write, and back.

`write_formulas`, `write_domain`, `write_plan` → `emitter` write. `reader` reads: the model by `pnm.language`, what only
planners need by `read_constraints`, comments by `read_comments`.
"""
