"""A house with a door that falls shut: who has no key does not get into the kitchen."""

from __future__ import annotations

from typing import Final

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem

HOUSE: Final = """
(define (domain house)
  (:requirements :typing :negative-preconditions :disjunctive-preconditions)
  (:types robot room door cup - object)
  (:predicates (at ?r - robot ?a - room) (way ?a ?b - room) (behind ?d - door ?a ?b - room) (open ?d - door) (key ?r - robot ?d - door)
    (locked ?d - door) (on ?c - cup ?a - room) (has ?r - robot ?c - cup) (broken ?r - robot))
  (:action move :parameters (?r - robot ?a ?b - room) :precondition (and (at ?r ?a) (way ?a ?b) (not (broken ?r)))
    :effect (and (not (at ?r ?a)) (at ?r ?b)))
  (:action pass :parameters (?r - robot ?d - door ?a ?b - room) :precondition (and (at ?r ?a) (behind ?d ?a ?b) (open ?d))
    :effect (and (not (at ?r ?a)) (at ?r ?b)))
  (:action open_door :parameters (?r - robot ?d - door ?a ?b - room)
    :precondition (and (at ?r ?a) (behind ?d ?a ?b) (or (key ?r ?d) (not (locked ?d)))) :effect (open ?d))
  (:action take :parameters (?r - robot ?c - cup ?a - room) :precondition (and (at ?r ?a) (on ?c ?a))
    :effect (and (has ?r ?c) (not (on ?c ?a)))))
"""


def house(init: str = "(locked door)", goal: str = "(and (has r1 cup) (at r1 hall))", cups: str = "(on cup kitchen)") -> Problem:
    """A robot in the hall, a cup in the kitchen behind a door that is shut and locked, and a yard on the way to nowhere."""
    things = "(:objects r1 - robot hall kitchen yard - room door - door cup - cup)"
    ways = "(way hall yard) (way yard hall) (behind door hall kitchen) (behind door kitchen hall)"
    text = f"(define (problem p) (:domain house) {things} (:init (at r1 hall) {cups} {ways} {init}) (:goal {goal}))"
    return parse_problem(text, parse_domain(HOUSE))
