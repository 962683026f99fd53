"""The orderings of a plan graph against what the nesting of its blocks says, read off the tree: all trees hypothesis makes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count, product

import yaml
from hypothesis import given, strategies as st

from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, Junction, flows
from pnm.language.plan import HandWrittenPlan, parse_plans

# --- trees, and what comes before what in them ---------------------------------------------


@dataclass(frozen=True)
class Call:
    name: str


@dataclass(frozen=True)
class Repeat:
    body: Tree


@dataclass(frozen=True)
class Either:
    then: Tree
    otherwise: Tree


@dataclass(frozen=True)
class Block:
    kind: str
    """``sequence``, ``concurrent_actions``, or either with lists ``after``."""
    parts: tuple[Tree, ...]
    waits: tuple[tuple[int, ...] | None, ...] | None = None
    """For every part, the numbers of those it waits for, or None to leave it unsaid."""


Tree = Call | Repeat | Either | Block


def size(tree: Tree) -> int:
    """How many steps of the same flow the tree becomes."""
    return sum(map(size, tree.parts)) if isinstance(tree, Block) else 1


def earlier(block: Block) -> set[tuple[int, int]]:
    """Which parts of the block come before which: as it is said, and all that follows from it.

    In a sequence, a part of which nothing is said comes after all before it that come after none from there on, as it is said.
    """
    numbers = range(len(block.parts))
    waits = [None for _ in numbers] if block.waits is None else block.waits
    said = closure({(one, number) for number, befores in enumerate(waits) for one in befores or ()}, numbers)
    unsaid = [number for number in numbers if waits[number] is None and block.kind == "sequence"]
    usual = {(one, number) for number in unsaid for one in range(number) if not any((later, one) in said for later in numbers[number:])}
    return closure(said | usual, numbers)


def closure(pairs: set[tuple[int, int]], numbers: Iterable[int]) -> set[tuple[int, int]]:
    found = set(pairs)
    for middle, first, last in product(numbers, repeat=3):
        if (first, middle) in found and (middle, last) in found:
            found.add((first, last))
    return found


def before(tree: Tree, start: int = 0) -> set[tuple[int, int]]:
    """Which steps come before which, numbered from `start` as they stand in the file."""
    if not isinstance(tree, Block):
        return set()
    starts = [start + sum(map(size, tree.parts[:number])) for number in range(len(tree.parts))]
    places = [range(first, first + size(part)) for first, part in zip(starts, tree.parts, strict=True)]
    inside = [before(part, first) for first, part in zip(starts, tree.parts, strict=True)]
    return set().union(*inside, *(product(places[one], places[two]) for one, two in earlier(tree)))


def holders(tree: Tree) -> list[Tree]:
    """The trees inside of loops and choices, outer ones first, in the order of the file."""
    match tree:
        case Call():
            return []
        case Repeat(body):
            return [body, *holders(body)]
        case Either(then, otherwise):
            return [then, *holders(then), otherwise, *holders(otherwise)]
        case Block(_, parts):
            return [inner for part in parts for inner in holders(part)]


# --- trees as files, and as graphs ---------------------------------------------------------


def as_steps(tree: Tree) -> object:
    match tree:
        case Call(name):
            return {name: {}}
        case Repeat(body):
            return {"while": {"condition": {"Query": "x"}, "actions": [as_steps(body)]}}
        case Either(then, otherwise):
            return {"if": {"Query": "x"}, "then": [as_steps(then)], "else": [as_steps(otherwise)]}
        case Block(kind, parts, waits):
            steps = [as_steps(part) for part in parts]
            if waits is not None:
                steps = [{**step, "id": f"n{number}"} for number, step in enumerate(steps)]  # type: ignore[dict-item]
                for step, befores in zip(steps, waits, strict=True):
                    if befores is not None:
                        step["after"] = [f"n{one}" for one in befores]  # type: ignore[index]
            return {kind: steps}


def names_in(tree: Tree) -> Iterator[str]:
    match tree:
        case Call(name):
            yield name
        case Repeat(body):
            yield from names_in(body)
        case Either(then, otherwise):
            yield from (*names_in(then), *names_in(otherwise))
        case Block(_, parts):
            for part in parts:
                yield from names_in(part)


def plan_from(tree: Tree) -> HandWrittenPlan:
    actions = dict.fromkeys(names_in(tree))
    return parse_plans(yaml.safe_dump({"actions": actions, "plan": [as_steps(tree)]}, sort_keys=False))["plan"]


def in_flow(flow: Flow) -> set[tuple[int, int]]:
    """Which steps of the flow that are no junctions come before which, numbered as they stand."""
    numbers = {step.index: number for number, step in enumerate(flow.steps)}
    pairs = {(numbers[one.before.call], numbers[one.after.call]) for one in flow.orderings}
    real = [number for number, step in enumerate(flow.steps) if not isinstance(step, Junction)]
    return {(real.index(one), real.index(two)) for one, two in closure(pairs, range(len(flow.steps))) if one in real and two in real}


def inner_flows(flow: Flow) -> list[Flow]:
    return [
        inner for step in flow.steps if not isinstance(step, ActionCall) for held in flows(step) for inner in (held, *inner_flows(held))
    ]


# --- all trees -----------------------------------------------------------------------------


@st.composite
def blocks(draw: st.DrawFn, parts: st.SearchStrategy[Tree]) -> Block:
    """A block, half of them with an order of its own: any that has no cycle, whatever the order in the file."""
    kind = draw(st.sampled_from(("sequence", "concurrent_actions")))
    length = draw(st.sampled_from((0, 1, 2, 2, 3, 3, 4)))
    inside = tuple(draw(parts) for _ in range(length))
    if not inside or draw(st.booleans()):
        return Block(kind, inside)
    ranks = draw(st.permutations(range(length)))
    waits: list[tuple[int, ...] | None] = []
    for rank in ranks:
        if draw(st.booleans()):
            waits.append(None)
        else:
            waits.append(tuple(one for one in range(length) if ranks[one] < rank and draw(st.booleans())))
    return Block(kind, inside, tuple(waits))


def holding(parts: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
    return (
        blocks(parts)
        | st.builds(Repeat, st.builds(lambda part: Block("sequence", (Call(""), part)), parts))
        | st.builds(Either, parts, parts)
    )


def numbered(tree: Tree, numbers: Iterator[int]) -> Tree:
    """Give every call a name of its own, in the order of the file."""
    match tree:
        case Call():
            return Call(f"a{next(numbers)}")
        case Repeat(body):
            return Repeat(numbered(body, numbers))
        case Either(then, otherwise):
            return Either(numbered(then, numbers), numbered(otherwise, numbers))
        case Block(kind, parts, waits):
            return Block(kind, tuple(numbered(part, numbers) for part in parts), waits)


trees = st.recursive(st.just(Call("")), holding, max_leaves=20).map(lambda tree: numbered(tree, count()))


@given(trees)
def test_what_comes_before_what_is_what_the_nesting_says(tree: Tree) -> None:
    graph = plan_from(tree).graph
    assert [call.action.name for call in graph.calls] == list(names_in(tree))
    found = [graph.flow, *inner_flows(graph.flow)]
    expected = [tree, *holders(tree)]
    assert len(found) == len(expected)
    for flow, part in zip(found, expected, strict=True):
        assert sum(not isinstance(step, Junction) for step in flow.steps) == size(part)
        assert in_flow(flow) == before(part)


@given(trees)
def test_every_ordering_is_said_once(tree: Tree) -> None:
    graph = plan_from(tree).graph
    for flow in (graph.flow, *inner_flows(graph.flow)):
        assert len({(one.before.call, one.after.call) for one in flow.orderings}) == len(flow.orderings)


@given(trees)
def test_every_tree_becomes_a_machine(tree: Tree) -> None:
    plan = plan_from(tree)
    assert generate(plan.graph, plan.bindings).plan is plan.graph


def test_wide_blocks_after_each_other_have_few_orderings() -> None:
    wide = Block("concurrent_actions", tuple(Call(f"a{number}") for number in range(50)))
    flow = plan_from(Block("sequence", (wide, wide, wide))).graph.flow
    assert len(flow.orderings) == 200
    assert sum(isinstance(step, Junction) for step in flow.steps) == 2


def test_the_oracle_sees_what_is_ordered() -> None:
    """Guards the test above: an order that is said the other way round, through an empty part, is seen by both sides."""
    tree = Block("sequence", (Call("a0"), Block("sequence", ()), Call("a1")), ((1,), (2,), ()))
    assert before(tree) == {(1, 0)}
    assert in_flow(plan_from(tree).graph.flow) == {(1, 0)}
