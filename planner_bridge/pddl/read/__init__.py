"""PDDL text → model."""
