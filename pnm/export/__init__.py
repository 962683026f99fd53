"""Machines written in other formats. Pure functions; the same machine gives the same bytes."""
