"""Loops, choices and junctions.

A loop counts its rounds: each takes a token from *left* and gives one to *spent*. When all are spent and the condition
still holds, the loop has failed.
"""

from __future__ import annotations

from pnm.generation.block import Block
from pnm.machine import Always, Denied, Ending, Holding
from pnm.plan_graph import Choice, Junction, Loop


class LoopBlock(Block[Loop]):
    """``head → body → head``, and out of it when the condition is not true."""

    def build(self) -> None:
        """Add the block to the machine."""
        head, done, failed = (self.place(name) for name in ("head", "done", "failed"))
        left, spent = self.name("left"), self.name("spent")
        self.builder.failure_places[failed] = self.step.index
        body = self.region(self.step.body, "body", repeated=True)
        self.enter("head")
        self.budget("left", "spent", self.step.limit)
        self.fire("skip", Ending(), "head", "done")
        self.add("loop_limit", Holding(self.step.condition), {head: 1, spent: self.step.limit}, [done, failed])
        self.add("repeat", Holding(self.step.condition), [head, left], [*body.first, spent])
        self.fire("no_more", Denied(self.step.condition), "head", "done")
        self.add("round_done", Always(), body.last, [head])
        self.leave()


class ChoiceBlock(Block[Choice]):
    """One of two regions."""

    def build(self) -> None:
        """Add the block to the machine."""
        head, done = self.place("head"), self.place("done")
        self.enter("head")
        self.fire("skip", Ending(), "head", "done")
        branches = (("then", Holding(self.step.condition), self.step.then), ("else", Denied(self.step.condition), self.step.otherwise))
        for name, guard, flow in branches:
            branch = self.region(flow, name, repeated=False)
            self.add(name, guard, [head], branch.first)
            self.add(f"{name}_done", Always(), branch.last, [done])
        self.leave()


class JunctionBlock(Block[Junction]):
    """Takes from all, gives to all."""

    def build(self) -> None:
        """Add the block to the machine."""
        self.place("done")
        self.enter("done")
        self.leave()
