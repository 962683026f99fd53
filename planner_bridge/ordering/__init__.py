"""Plan → plan graph: causal links and enclosing actions."""
