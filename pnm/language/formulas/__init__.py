"""Formulas of the YAML language: words, scopes, conditions, values, effects.

Every reader raises InputError, with the position, for what is malformed or has names that are not there.
"""
