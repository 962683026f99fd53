"""Formulas of the YAML language: words, scopes, conditions, values, effects."""
