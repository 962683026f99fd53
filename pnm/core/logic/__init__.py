"""Logic over facts: expressions, conditions, effects, derivation rules, trajectory constraints, computed values."""
