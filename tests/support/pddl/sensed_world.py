"""A small world of robots, for tests of what their sensors report."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

from planner_bridge.pddl import parse_domain, parse_problem
from pnm.core.message_fields import value_in
from pnm.knowledge.sensor_file import read_sensing
from tests.support.files import written

DOMAIN = parse_domain(
    """(define (domain d) (:requirements :adl :fluents :derived-predicates)
    (:types robot place - object arm - robot)
    (:predicates (charged ?r - robot) (at ?r - robot ?p - place) (ready ?r - robot) (dark))
    (:functions (battery ?r - robot) - number (location ?r - robot) - place)
    (:derived (ready ?r - robot) (charged ?r))
    (:action wait :parameters (?r - robot)))"""
)


PROBLEM = parse_problem("(define (problem p) (:domain d) (:objects r1 r-2 - robot a1 - arm kitchen hall - place) (:goal (dark)))", DOMAIN)


KNOWN = PROBLEM.vocabulary


def objects(types):
    return tuple(dict.fromkeys(name for kind in types for name in PROBLEM.objects_by_type.get(kind, ())))


def look(message):
    """Return a function that looks into plain data as it would into a message."""

    return partial(value_in, message)


EVERYTHING = """\
stale: 30
sensors:
  - topic: /{r}/battery
    type: test_msgs/msg/BasicTypes
    for: {r: robot}
    facts:
      - number: (battery ?r)
        field: percentage
      - fact: (charged ?r)
        when: {field: percentage, ge: 0.8}
    stale: 10
    lag: 0.5
  - topic: /{r}/zone
    for: {r: robot}
    facts:
      - fact: (at ?r ?value)
        field: zones[0].name
        table: {A1: kitchen, 2: hall, "": undefined}
      - object: (location ?r)
        field: room
    variables:
      - {name: "{r}_zone", field: zones}
  - service: light
    request: {room: [hall], level: 2}
    every: 2.0
    limit: 0.5
    facts:
      - fact: (dark)
        when: {any: [{not: {field: on}}, {all: [{field: lux, lt: 5, gt: 0}, {field: names, contains: moon}]}]}
"""
with tempfile.TemporaryDirectory() as _folder:
    SENSING = read_sensing(written(Path(_folder), EVERYTHING), KNOWN)
