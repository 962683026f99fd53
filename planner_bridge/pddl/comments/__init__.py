"""Comments of PDDL files, kept across PDDL ↔ YAML."""
