"""Nodes and values of formulas in YAML."""

from __future__ import annotations

from pnm.core.logic.computed_values import Layer, Literal, Query
from pnm.files.yaml_nodes import Node, parse_yaml


def node(text: str) -> Node:
    found = parse_yaml(f"x: {text}", "F")[0].node("x")
    assert found is not None
    return found


def q(name: str, layer: Layer = Layer.LOCAL) -> Query:
    return Query(Literal.of(name), layer)


def lit(value: object) -> Literal:
    return Literal.of(value)
