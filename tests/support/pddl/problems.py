"""Small PDDL worlds for tests: robots in rooms, fuses by the light of matches, tanks, and pigeons for whom there are not enough holes."""

from __future__ import annotations

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from pnm.core.logic.conditions import Condition
from pnm.errors import InputError

ROOMS = """
(define (domain rooms)
  (:requirements :strips :typing :negative-preconditions)
  (:types robot room - object)
  (:predicates (at ?r - robot ?a - room) (way ?a ?b - room) (clean ?a - room))
  (:functions (total-cost) (energy ?r - robot))
  (:action move :parameters (?r - robot ?a ?b - room)
    :precondition (and (at ?r ?a) (way ?a ?b))
    :effect (and (not (at ?r ?a)) (at ?r ?b) (increase (total-cost) 1)))
  (:action sweep :parameters (?r - robot ?a - room)
    :precondition (and (at ?r ?a) (not (clean ?a)))
    :effect (clean ?a)))
"""

MATCHES = """
(define (domain matches)
  (:requirements :durative-actions :typing)
  (:types match fuse - object)
  (:predicates (light ?m - match) (free) (unused ?m - match) (mended ?f - fuse))
  (:durative-action strike :parameters (?m - match) :duration (= ?duration 8)
    :condition (and (at start (unused ?m)) (over all (light ?m)))
    :effect (and (at start (not (unused ?m))) (at start (light ?m)) (at end (not (light ?m)))))
  (:durative-action mend :parameters (?f - fuse ?m - match) :duration (= ?duration 5)
    :condition (and (at start (free)) (over all (light ?m)))
    :effect (and (at start (not (free))) (at end (mended ?f)) (at end (free)))))
"""

TANKS = """
(define (domain tanks)
  (:requirements :typing :numeric-fluents)
  (:types tank)
  (:predicates (open ?t - tank))
  (:functions (level ?t - tank))
  (:action pour :parameters (?from ?to - tank)
    :precondition (and (open ?to) (>= (level ?from) 2) (not (= ?from ?to)))
    :effect (and (decrease (level ?from) 2) (increase (level ?to) 2)))
  (:action unlock :parameters (?t - tank) :effect (open ?t)))
"""


def rooms(init: str = "(at r1 a) (at r2 a)", goal: str = "(and (at r1 c) (at r2 c))", ways: str = "ab bc ad dc") -> Problem:
    """Rooms a, b, c, d, and those that ways name besides; by default two ways from a to c, over b and over d."""
    links = " ".join(f"(way {way[0]} {way[1]})" for way in ways.split())
    names = sorted({*"abcd", *"".join(ways.split())})
    things = f"(:objects r1 r2 - robot {' '.join(names)} - room)"
    text = f"(define (problem p) (:domain rooms) {things} (:init {init} {links} (= (total-cost) 0)) (:goal {goal}))"
    return parse_problem(text, parse_domain(ROOMS))


def matches(fuses: int = 2) -> Problem:
    """As many matches as fuses; a fuse is mended while a match burns."""
    things = " ".join(f"m{n}" for n in range(fuses)) + " - match " + " ".join(f"f{n}" for n in range(fuses)) + " - fuse"
    init = "(free) " + " ".join(f"(unused m{n})" for n in range(fuses))
    goal = " ".join(f"(mended f{n})" for n in range(fuses))
    return parse_problem(
        f"(define (problem p) (:domain matches) (:objects {things}) (:init {init}) (:goal (and {goal})))", parse_domain(MATCHES)
    )


def tanks(level: str = "4") -> Problem:
    """Two pours of two from one tank into another."""
    text = f"""(define (problem p) (:domain tanks) (:objects a b - tank)
        (:init (= (level a) {level}) (= (level b) 0)) (:goal (>= (level b) 4)))"""
    return parse_problem(text, parse_domain(TANKS))


def hard(holes: int = 30) -> Problem:
    """One pigeon more than holes: there is no plan, but no planner can see that soon."""
    domain = """(define (domain d) (:requirements :typing) (:types pigeon hole) (:predicates (sits ?p - pigeon) (free ?h - hole))
        (:action sit :parameters (?p - pigeon ?h - hole) :precondition (free ?h) :effect (and (sits ?p) (not (free ?h))))
        (:action swap :parameters (?p ?q - pigeon) :precondition (sits ?p) :effect (and (not (sits ?p)) (sits ?q))))"""
    things = f"{' '.join(f'p{n}' for n in range(holes + 1))} - pigeon {' '.join(f'h{n}' for n in range(holes))} - hole"
    init, goal = (" ".join(f"({fact}{n})" for n in range(count)) for fact, count in (("free h", holes), ("sits p", holes + 1)))
    return parse_problem(f"(define (problem p) (:domain d) (:objects {things}) (:init {init}) (:goal (and {goal})))", parse_domain(domain))


FLOOR = """
(define (domain floor) (:requirements :typing) (:types robot tile colour)
  (:predicates (on ?r - robot ?t - tile) (beside ?a ?b - tile) (over ?a ?b - tile) (bare ?t - tile) (has ?t - tile ?c - colour)
    (brush ?r - robot ?c - colour))
  (:action move :parameters (?r - robot ?a ?b - tile)
    :precondition (and (on ?r ?a) (beside ?a ?b) (bare ?b)) :effect (and (on ?r ?b) (bare ?a) (not (on ?r ?a)) (not (bare ?b))))
  (:action dip :parameters (?r - robot ?c ?d - colour) :precondition (brush ?r ?c) :effect (and (brush ?r ?d) (not (brush ?r ?c))))
  (:action paint :parameters (?r - robot ?a ?b - tile ?c - colour)
    :precondition (and (on ?r ?a) (over ?b ?a) (bare ?b) (brush ?r ?c)) :effect (and (has ?b ?c) (not (bare ?b)))))
"""


def tiles(width: int = 4, height: int = 4) -> Problem:
    """Two robots paint all rows but the first of a floor like a chessboard. Kairos' first way of searching paints itself into a corner."""
    name = {(x, y): f"t{x}{y}" for x in range(width) for y in range(height)}
    beside = [f"(beside {name[a]} {name[b]})" for a in name for b in name if abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1]
    over = [f"(over {name[a]} {name[b]})" for a in name for b in name if a[0] == b[0] and abs(a[1] - b[1]) == 1]
    robots = "(on r0 t00) (brush r0 black) (on r1 t10) (brush r1 white)"
    bare = [f"(bare {tile})" for tile in name.values() if tile not in ("t00", "t10")]
    goal = [f"(has {tile} {('black', 'white')[(x + y) % 2]})" for (x, y), tile in name.items() if y]
    objects = f"{' '.join(name.values())} - tile r0 r1 - robot black white - colour"
    init = " ".join((*beside, *over, *bare, robots))
    return parse_problem(
        f"(define (problem p) (:domain floor) (:objects {objects}) (:init {init}) (:goal (and {' '.join(goal)})))", parse_domain(FLOOR)
    )


_FLEET = """
(define (domain fleet)
  (:requirements :strips :typing :negative-preconditions{requires})
  (:types robot parcel room - object)
  (:predicates
    (at ?r - robot ?a - room) (way ?a ?b - room) (in ?p - parcel ?a - room) (has ?r - robot ?p - parcel) (free ?r - robot)){functions}
  (:action move :parameters (?r - robot ?a ?b - room)
    :precondition (and (at ?r ?a) (way ?a ?b))
    :effect (and (not (at ?r ?a)) (at ?r ?b){moved}))
  (:action pick :parameters (?r - robot ?p - parcel ?a - room)
    :precondition (and (at ?r ?a) (in ?p ?a) (free ?r))
    :effect (and (not (in ?p ?a)) (has ?r ?p) (not (free ?r)){picked}))
  (:action drop :parameters (?r - robot ?p - parcel ?a - room)
    :precondition (and (at ?r ?a) (has ?r ?p))
    :effect (and (in ?p ?a) (not (has ?r ?p)) (free ?r))))
"""
_COUNTS = {
    "requires": " :numeric-fluents",
    "functions": " (:functions (moves ?r - robot) (picks ?p - parcel))",
    "moved": " (increase (moves ?r) 1)",
    "picked": " (increase (picks ?p) 1)",
}


def fleet(robots: int = 2, parcels: int = 4, places: int = 4, goal: str = "(and)") -> Problem:
    """Robots and parcels in rooms that lie around a court: each leads to the next one, and back."""
    domain, problem = fleet_texts(robots, parcels, places, goal)
    return parse_problem(problem, parse_domain(domain))


def fleet_texts(robots: int, parcels: int, places: int, goal: str = "(and)", *, counts: bool = False) -> tuple[str, str]:
    """Return that domain and problem; if it counts, what is done twice, or noted twice, is counted twice."""
    ring = [f"(way a{n} a{m})" for n in range(places) for m in ((n + 1) % places, (n - 1) % places)]
    init = [f"(at r{n} a{n % places}) (free r{n})" for n in range(robots)] + [f"(in p{n} a{n % places})" for n in range(parcels)]
    if counts:
        init += [f"(= (moves r{n}) 0)" for n in range(robots)] + [f"(= (picks p{n}) 0)" for n in range(parcels)]
    things = " ".join(
        f"{' '.join(f'{letter}{n}' for n in range(count))} - {kind}"
        for letter, count, kind in (("r", robots, "robot"), ("p", parcels, "parcel"), ("a", places, "room"))
    )
    text = f"(define (problem p) (:domain fleet) (:objects {things}) (:init {' '.join(dict.fromkeys(init + ring))}) (:goal {goal}))"
    return _FLEET.format(**(_COUNTS if counts else dict.fromkeys(_COUNTS, ""))), text


def read_goal(problem: Problem, text: str) -> Condition:
    """Read another goal in the words of a problem."""
    if not text.startswith("("):
        raise InputError(f"not a goal: {text!r}")
    objects = " ".join(f"{name} - {kinds[0]}" for name, kinds in problem.own_objects.items())
    whole = f"(define (problem q) (:domain {problem.domain.name}) (:objects {objects}) (:init) (:goal {text}))"
    return parse_problem(whole, problem.domain).goal
