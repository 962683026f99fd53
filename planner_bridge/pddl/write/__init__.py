"""Model → PDDL text."""
