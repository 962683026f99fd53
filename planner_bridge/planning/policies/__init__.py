"""Policies: what to do in which state, where actions may turn out in several ways."""
