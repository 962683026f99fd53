"""The workshop's problems solved with py_trees (BSD), as a careful engineer does it by hand.

The trees are back-chained: every step asks first whether what it is for is so already. A tick performs one action at most and looks at
everything anew, so an attempt that has failed is made again, and the robot goes to the charger between any two actions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from pyrobosim.core import World

from tests.support.e2e.household.simulator import asked, perform

LOW: Final = 30.0
"""Per cent of the battery below which the robot goes to the charger, as in the workshop's own trees."""
ENOUGH: Final = 400
"""Ticks after which the tree is given up; the longest solution takes about 70."""


class Asked(Behaviour):  # type: ignore[misc]
    """A condition."""

    def __init__(self, name: str, is_so: Callable[[], bool]) -> None:
        super().__init__(name)
        self._is_so = is_so

    def update(self) -> Status:
        """Ask it."""
        return Status.SUCCESS if self._is_so() else Status.FAILURE


class Done(Behaviour):  # type: ignore[misc]
    """An action. It is running at the end of its tick, whatever became of it: the next tick sees."""

    def __init__(self, world: World, kind: str, what: str) -> None:
        super().__init__(f"{kind} {what}")
        self._world = world
        self._wanted = asked(world.robots[0], kind, what)

    def update(self) -> Status:
        """Perform it once."""
        perform(self._world, self._wanted)
        return Status.RUNNING


class TreeByHand:
    """The tree of a problem in a world."""

    def __init__(self, world: World, problem: int) -> None:
        self._world = world
        self._robot = world.robots[0]
        snacks = [self._delivered("snacks0", "pantry", "table")]
        breakfast = [*self._laid("bread0", "pantry"), *self._laid("butter0", "fridge")]
        waste = [
            self._either(
                Asked("all in the dumpster", lambda: self._is_in("waste0", "dumpster") and self._is_in("waste1", "dumpster")),
                self._opened("hall_dining_trash"),
                self._opened("dumpster"),
                self._delivered("waste0", "desk", "dumpster"),
                self._delivered("waste1", "bin", "dumpster"),
            ),
            self._closed("dumpster"),
        ]
        door = "hall_closet_dining"
        powered = self._either(
            Asked("charged, or shut out", lambda: self._robot.battery_level >= LOW or not self._is_open(door)),
            Done(world, "navigate", "charger"),
        )
        steps = {1: snacks, 2: waste, 3: breakfast, 4: [powered, self._opened(door), *breakfast, *waste]}[problem]
        self._root = Sequence("goal", memory=False, children=steps)

    def run(self) -> bool:
        """Tick the tree until it succeeds, the battery is empty, or the tree is given up; return whether it succeeds."""
        for _ in range(ENOUGH):
            self._root.tick_once()
            if self._root.status is Status.SUCCESS or self._robot.battery_level <= 0:
                break
        return self._root.status is Status.SUCCESS

    def _either(self, wanted: Behaviour, *steps: Behaviour) -> Behaviour:
        """Return a tree that has what is wanted, or takes these steps."""
        return Selector(wanted.name, memory=False, children=[wanted, Sequence("else", memory=False, children=list(steps))])

    def _step(self, is_so: Callable[[], bool], place: str, kind: str, what: str) -> Behaviour:
        """Return a tree that performs an action at its place unless what it is for is so."""

        def is_there() -> bool:
            spot = self._robot.location
            return spot is not None and place in (spot.name, getattr(spot.parent, "name", ""))

        there = self._either(Asked(f"at {place}", is_there), Done(self._world, "navigate", place))
        return self._either(Asked(f"done: {kind} {what}", is_so), there, Done(self._world, kind, what))

    def _opened(self, what: str) -> Behaviour:
        return self._step(lambda: self._is_open(what), what, "open", what)

    def _closed(self, what: str) -> Behaviour:
        return self._step(lambda: not self._is_open(what), what, "close", what)

    def _delivered(self, item: str, source: str, target: str) -> Behaviour:
        held = self._step(lambda: getattr(self._robot.manipulated_object, "name", "") == item, source, "pick", item)
        put = self._step(lambda: self._is_in(item, target), target, "place", item)
        return self._either(Asked(f"{item} in {target}", lambda: self._is_in(item, target)), held, put)

    def _laid(self, item: str, furniture: str) -> tuple[Behaviour, Behaviour]:
        """Return the trees that take an item from its furniture to the table, and that close the furniture."""
        laid = Asked(f"{item} on the table", lambda: self._is_in(item, "table"))
        return self._either(laid, self._opened(furniture), self._delivered(item, furniture, "table")), self._closed(furniture)

    def _is_open(self, place: str) -> bool:
        return bool(self._world.get_entity_by_name(place).is_open)

    def _is_in(self, item: str, furniture: str) -> bool:
        parent = self._world.get_object_by_name(item).parent
        return getattr(getattr(parent, "parent", None), "name", "") == furniture
