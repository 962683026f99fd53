"""PDDL as text: s-expressions with positions, sections, words, pretty printing."""
