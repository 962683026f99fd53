"""Behaviour trees of BehaviorTree.CPP, version 4 of its files: plans and policies written as trees, and trees read as plans by hand.

Of a plan a tree has the calls and their order; the rest is lost, and said. A tree is read if its nodes end by themselves; reactive nodes,
which ask again while others run, are refused by name: here a condition for all of an action is one of the action's own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Final, NamedTuple, assert_never

from planner_bridge.yaml.emitter import Bare, Entry, Value, YamlMapping, document, items, single
from planner_bridge.yaml.writer import Block, Mesh, Parallel, Series, blocks
from pnm.core.logic.computed_values import Literal, Query
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall, Choice, Flow, Junction, Loop, Moment, PlanGraph, Step, Then, WaitUntil, in_order
from pnm.core.net.net import reduced
from pnm.core.pictures.xml_text import Element, read_xml, xml
from pnm.errors import InputError, suggestion
from pnm.language.grammar import RESERVED, Document

_PORT: Final = re.compile(r"(?!ID$|name$|_)[A-Za-z_][A-Za-z0-9_.-]*")
"""Names that the attribute of a node may have as a port."""

_NOTHING: Final[Mapping[str, str]] = {}

# --- writing ----------------------------------------------------------------------------------


class TreeNode(NamedTuple):
    """A node of a tree."""

    tag: str
    attributes: Mapping[str, str] = {}
    children: tuple[TreeNode, ...] = ()

    def lines(self, indent: str) -> Iterator[str]:
        """Yield it as XML."""
        attributes = "".join(f' {key}="{xml(value)}"' for key, value in self.attributes.items())
        start = f"{indent}<{self.tag}{attributes}"
        if not self.children:
            yield f"{start}/>"
            return
        yield f"{start}>"
        for child in self.children:
            yield from child.lines(f"{indent}  ")
        yield f"{indent}</{self.tag}>"


class Tree(NamedTuple):
    """A tree as text, and what it lacks of what it was made from."""

    text: str
    lost: tuple[str, ...]


_SUCCESS: Final = TreeNode("AlwaysSuccess")
_ENDLESS: Final = {"num_attempts": "-1"}


def _all(children: Sequence[TreeNode], tag: str = "Sequence") -> TreeNode:
    return children[0] if len(children) == 1 else TreeNode(tag, {}, tuple(children)) if children else _SUCCESS


def _holds(condition: object) -> TreeNode:
    return TreeNode("Condition", {"ID": "Holds", "condition": str(condition)})


def _msec(seconds: float) -> str:
    """Return a limit in milliseconds, one at least: none is no limit there."""
    return str(max(1, ceil(round(seconds * 1000, 6))))


class _TreeWriter:
    """Makes the nodes of a plan, or of a policy. The mutable state are the ports of actions that are seen, and what is lost."""

    def __init__(self) -> None:
        self.models: dict[str, dict[str, str]] = {}
        self.lost: dict[str, None] = {"preconditions, effects, results, resources and the proof: leaves are calls alone": None}

    def text(self, node: TreeNode) -> Tree:
        """Return the file of a tree."""
        ports = {
            name: tuple(TreeNode(kind, {"name": port, "type": "std::string"}) for port, kind in its.items())
            for name, its in self.models.items()
        }
        asks = TreeNode("Condition", {"ID": "Holds"}, (TreeNode("input_port", {"name": "condition", "type": "std::string"}),))
        nodes = (*(TreeNode("Action", {"ID": name}, its) for name, its in ports.items()), asks)
        tree = TreeNode("BehaviorTree", {"ID": "Plan"}, (node,))
        root = TreeNode("root", {"BTCPP_format": "4", "main_tree_to_execute": "Plan"}, (tree, TreeNode("TreeNodesModel", {}, nodes)))
        notes = (f"<!-- lost: {xml(one).replace('--', '- -')} -->" for one in self.lost)
        return Tree("\n".join(('<?xml version="1.0" encoding="UTF-8"?>', *notes, *root.lines(""), "")), tuple(self.lost))

    def action(self, name: str, arguments: Mapping[str, str], title: str, stored: Mapping[str, str] = _NOTHING) -> TreeNode:
        """Return a leaf. What cannot be a name of a port is one by its number."""
        ports = {key if _PORT.fullmatch(key) else f"arg{number}": value for number, (key, value) in enumerate(arguments.items())}
        results = {key: f"{{{variable}}}" for key, variable in stored.items() if _PORT.fullmatch(key) and key not in ports}
        model = self.models.setdefault(name, {})
        model.update(dict.fromkeys(ports, "input_port") | dict.fromkeys(results, "output_port"))
        return TreeNode("Action", {"ID": name, "name": title, **ports, **results})

    def flow(self, flow: Flow) -> TreeNode:
        """Return the node of some steps, which keep their order as far as sequences and parallel nodes can."""
        steps = {step.index: step for step in flow.steps}
        order = [event.call for event in in_order(flow) if event.moment is Moment.START]
        number = {index: position for position, index in enumerate(order)}
        pairs = {(number[one.before.call], number[one.after.call]) for one in flow.orderings}
        if any((one.before.moment, one.after.moment) != (Moment.END, Moment.START) or one.delay for one in flow.orderings):
            self.lose("orderings of starts, or of ends, and delays: a step waits for the ends of others alone")
        if not order:
            return _SUCCESS
        return self.block(blocks(reduced(len(order), (pair for pair in pairs if pair[0] < pair[1]))), [steps[index] for index in order])

    def block(self, block: Block, steps: Sequence[Step]) -> TreeNode:
        """Return the node of a part of an order."""
        match block:
            case int():
                return self.step(steps[block])
            case Series(parts):
                return _all([self.block(part, steps) for part in parts])
            case Parallel(parts):
                ends = {"success_count": "-1", "failure_count": "1"}
                return TreeNode("Parallel", ends, tuple(self.block(part, steps) for part in parts))
            case Mesh(before):
                self.lose("concurrency, where the order of steps is not one of sequences and parallel parts: they are one after the other")
                return _all([self.step(steps[number]) for number in before])
            case _:
                assert_never(block)

    def lose(self, what: str) -> None:
        """Note that something is lost."""
        self.lost[what] = None

    def step(self, step: Step) -> TreeNode:
        """Return the node of a step."""
        match step:
            case ActionCall():
                return self.call(step)
            case Choice():
                return TreeNode("IfThenElse", {}, (_holds(step.condition), self.flow(step.then), self.flow(step.otherwise)))
            case Loop():  # a round in which the condition no longer holds does nothing
                ends = TreeNode("Inverter", {}, (_holds(step.condition),))
                rounds = TreeNode("Repeat", {"num_cycles": str(step.limit)}, (TreeNode("Fallback", {}, (ends, self.flow(step.body))),))
                return TreeNode("Sequence", {}, (rounds, ends))
            case WaitUntil():
                asks = TreeNode("RetryUntilSuccessful", _ENDLESS, (_holds(step.condition),))
                return TreeNode("Timeout", {"msec": _msec(step.limit)}, (asks,))
            case Junction():
                return _SUCCESS
            case _:
                assert_never(step)

    def call(self, call: ActionCall) -> TreeNode:
        """Return the node of a call, with its limits and recoveries around it."""
        action, given = call.action, dict(call.action.given)
        names = action.parameters if len(action.parameters) == len(action.arguments) else map(str, range(len(action.arguments)))
        ports = dict[str, str]()
        for name, text in zip(names, action.arguments, strict=True):
            ports[name] = text
            if text.startswith("{") and text.endswith("}"):
                self.lose("texts in braces: a leaf reads them as entries of the blackboard")
            if text.startswith("?"):  # it has no value before
                asked = given.get(name)
                variable = asked.name.value if isinstance(asked, Query) and isinstance(asked.name, Literal) else name
                ports[name] = f"{{{variable}}}"
                if asked is not None and not isinstance(asked, Query):
                    self.lose("values that are computed: a leaf finds them on the blackboard, under the name of its port")
        node = self.action(action.name, ports, str(call), dict(call.store))
        if call.release or call.latest_start < float("inf") or call.deadline < float("inf"):
            self.lose("times at which calls may start, and deadlines")
        if action.operation:
            self.lose("what operations on knowledge do: they are leaves")
        if action.outcomes:
            self.lose("outcomes: a leaf succeeds or fails")
        if call.timeout is not None:
            node = TreeNode("Timeout", {"msec": _msec(call.timeout)}, (node,))
        if call.retries and not any(Cause.ABORTED in one.causes for one in call.recoveries):  # which come in place of other attempts
            node = TreeNode("RetryUntilSuccessful", {"num_attempts": str(call.retries + 1)}, (node,))
        ways = [node]
        for one in call.recoveries:
            if Cause.ABORTED not in one.causes:  # of which a leaf knows nothing: that of any plan by hand, after others, says so of itself
                if one.chain.steps or one.then not in (Then.CONTINUE, Then.RETRY):
                    self.lose("recoveries after other failures than that the action was aborted")
                continue
            chain = [self.flow(one.chain)] if one.chain.steps else []
            ends = {Then.RETRY: [node], Then.CONTINUE: [], Then.SKIP: []}.get(one.then, [TreeNode("AlwaysFailure")])
            way = _all([*chain, *ends])
            again = TreeNode("RetryUntilSuccessful", {"num_attempts": str(one.times)}, (way,))
            ways.append(again if one.times > 1 and one.then is Then.RETRY else way)
        return _all(ways, "Fallback")


def plan_tree(graph: PlanGraph) -> Tree:
    """Return a plan as a tree; its goal is asked for at the end."""
    writer = _TreeWriter()
    node = writer.flow(graph.flow)
    return writer.text(node if graph.goal == TRUE else TreeNode("Sequence", {}, (node, _holds(graph.goal))))


def policy_tree(policy: Mapping[str, Any], goal: object) -> Tree:
    """Return a policy as a tree, given what `pnm plan --json` prints of it: until the goal holds, the first entry that fits is done."""
    writer = _TreeWriter()
    writer.lose("chances, and how many calls are expected")
    entries = []
    for number, entry in enumerate(policy["entries"]):
        arguments = {str(position): one for position, one in enumerate(entry["arguments"])}
        title = f"{entry['action']}({', '.join(entry['arguments'])})#{number}"
        does = TreeNode("ForceSuccess", {}, (writer.action(entry["action"], arguments, title),))
        entries.append(TreeNode("Sequence", {}, (*map(_holds, entry["facts"]), does)))
    # a round is a failure, after which the next one begins; so is a state for which there is no entry, which then is asked for again;
    # a call is a success in any case, or else the next entry would follow upon a failure
    again = TreeNode("ForceFailure", {}, (_all(entries, "Fallback"),))
    return writer.text(TreeNode("RetryUntilSuccessful", _ENDLESS, (TreeNode("Fallback", {}, (_holds(goal), again)),)))


# --- reading ----------------------------------------------------------------------------------


_CAUSES: Final = ("aborted", "preempted", "rejected", "unavailable", "timed_out", "lost")
"""The ends of a request that are the failure of a leaf."""
_KEEP: Final = "keep"
"""The operation that keeps whether a node has failed."""
_MOST: Final = 100
"""Rounds of a `Repeat`, whose steps are written so often."""
_LIMIT: Final = 100_000
"""Steps of all plans: trees may call each other again and again."""
_REFUSED: Final = {
    "ReactiveSequence": "it asks again while others run; expected a Sequence, and the condition among those of the action",
    "ReactiveFallback": "it asks again while others run; expected a Fallback",
    **dict.fromkeys(
        ("Switch2", "Switch3", "Switch4", "Switch5", "Switch6", "WhileDoElse"), "it asks again while others run; expected IfThenElse"
    ),
    **dict.fromkeys(("Script", "ScriptCondition", "SetBlackboard", "UnsetBlackboard", "Precondition"), "scripts are not read"),
    **dict.fromkeys(("Inverter", "ForceFailure", "AlwaysFailure"), "it goes on after a failure; expected Fallback or IfThenElse"),
    **dict.fromkeys(
        ("KeepRunningUntilFailure", "Delay", "RunOnce", "ConsumeQueue", "EntryUpdated", "Sleep", "LoopDouble"), "there is no such step"
    ),
    "AsyncSequence": "expected a Sequence",
    "AsyncFallback": "expected a Fallback",
    "ParallelAll": "expected Parallel",
}
"""Nodes of BehaviorTree.CPP that are not read, and why."""
_KNOWN: Final = ("Sequence", "SequenceWithMemory", "Fallback", "Parallel", "IfThenElse", "RetryUntilSuccessful", "Repeat", "Timeout")
_CONTROL: Final = (*_KNOWN, "ForceSuccess", "SubTree", "AlwaysSuccess")


@dataclass
class _Call:
    """A call that is read, with what is around it."""

    name: str
    arguments: dict[str, Value]
    stored: dict[str, str] = field(default_factory=dict)
    retries: int = 0
    timeout: float | None = None
    then: list[Value] | None = None
    """The chain after a failure."""

    @property
    def is_plain(self) -> bool:
        return not self.retries and self.timeout is None and self.then is None

    def step(self) -> YamlMapping:
        """Return it as a step."""
        called = YamlMapping(tuple([Entry(value, name) for name, value in self.arguments.items()]), short=True)
        options: list[Entry] = []
        if self.stored:
            options.append(
                Entry(YamlMapping(tuple([Entry(variable, name) for name, variable in self.stored.items()]), short=True), "store")
            )
        if self.retries:
            options.append(Entry(Bare(str(self.retries)), "retries"))
        if self.timeout is not None:
            options.append(Entry(Bare(f"{self.timeout:.10g}"), "timeout"))
        if self.then is not None:
            chain = items(self.then, short=len(self.then) < 3)
            during = YamlMapping(tuple([Entry(chain, cause) for cause in _CAUSES]))
            options.append(Entry(single("during", during), "recoveries"))
        return YamlMapping((Entry(called, self.name), *options))


@dataclass
class _Plan:
    """A plan that is made. The mutable state is what of it there is so far."""

    name: str
    used: dict[str, None] = field(default_factory=dict)
    """Variables that it asks for."""
    stored: dict[str, None] = field(default_factory=dict)
    steps: list[YamlMapping] = field(default_factory=list)
    parts: int = 0
    """Plans that were made of its parts."""
    halts: bool = False
    """Whether calls that run beside one that fails are cancelled."""


class _TreeReader:
    """Makes plans of the trees of a file. The mutable state is what there is so far."""

    def __init__(self, root: Element) -> None:
        if (root.tag, root.attributes.get("BTCPP_format")) != ("root", "4"):
            raise InputError('expected <root BTCPP_format="4">, a file of BehaviorTree.CPP 4', root.position)
        self.trees: dict[str, Element] = {}
        for node in root.contents:
            if node.tag not in ("BehaviorTree", "TreeNodesModel"):
                raise InputError(f"<{node.tag}> is not read here; expected a <BehaviorTree>, and all of them in this file", node.position)
            if node.tag == "TreeNodesModel":
                continue
            if (name := node.of("ID")) in self.trees:
                raise InputError(f"there are two trees {name!r}; the other one is at {self.trees[name].position}", node.position)
            if name in (RESERVED | Document.known.keys() | {_KEEP}):
                raise InputError(f"a tree cannot be called {name!r}: it is a word of the language", node.position)
            self.trees[name] = node
        if not self.trees:
            raise InputError("expected a <BehaviorTree>", root.position)
        self.main = root.attributes.get("main_tree_to_execute", "MainTree" if "MainTree" in self.trees else next(iter(self.trees)))
        if self.main not in self.trees:
            raise InputError(f"there is no tree {self.main!r}; {suggestion(self.main, self.trees)}".rstrip("; "), root.position)
        self.models = {node.of("ID"): node for model in root.all("TreeNodesModel") for node in model.contents}
        self.plans: dict[str, _Plan] = {}
        self.actions: dict[str, dict[str, None]] = {}
        self.open: list[str] = []
        self.count = 0

    def text(self) -> str:
        """Return the plans as one file of the language, that of the main tree first."""
        for name in (self.main, *self.trees):
            self.plan_of(name, self.trees[name])
        entries = [Entry(single("params", items(params, short=True), short=True), name) for name, params in sorted(self.actions.items())]
        keep = [Entry(single("type", "kb_action", short=True), _KEEP)] if any(plan.name == _KEEP for plan in self.plans.values()) else []
        whole = [Entry(YamlMapping((*entries, *keep)), "actions")]
        for plan in sorted(self.plans.values(), key=lambda plan: plan.name != self.main):
            if plan.name == _KEEP:
                continue
            keys = [Entry(items(plan.used, short=True), "params")] if plan.used and plan.name != self.main else []
            keys += [Entry(items(plan.stored, short=True), "results")] if plan.stored and plan.name != self.main else []
            keys += [Entry("cancel", "on_failure")] if plan.halts else []
            whole.append(Entry(YamlMapping((*keys, Entry(items(plan.steps), "plan"))), plan.name, apart=True))
        return document(YamlMapping(tuple(whole)))

    def plan_of(self, name: str, *nodes: Element) -> _Plan:
        """Return the plan of some nodes, one after the other; it is made once."""
        if name in self.plans:
            return self.plans[name]
        plan = _Plan(name)
        self.open.append(name)
        for node in nodes:
            for child in node.contents if node.tag == "BehaviorTree" else (node,):
                plan.steps += self.steps(child, plan)
        self.open.pop()
        self.plans[name] = plan
        return plan

    def steps(self, node: Element, plan: _Plan) -> list[YamlMapping]:
        """Return the steps of a node."""
        self.count += 1
        if self.count > _LIMIT:
            raise InputError(f"the plan has more than {_LIMIT} steps", node.position)
        match node.tag:
            case "Sequence" | "SequenceWithMemory":
                return [step for child in node.contents for step in self.steps(child, plan)]
            case "Parallel":
                wanted = node.attributes.get("success_count", "-1"), node.attributes.get("failure_count", "1")
                if wanted not in (("-1", "1"), (str(len(node.contents)), "1")):
                    raise InputError(
                        "<Parallel> is read if all of its nodes must succeed: success_count -1, failure_count 1", node.position
                    )
                plan.halts = True
                return [single("concurrent_actions", items(self.branch(child, plan) for child in node.contents))]
            case "Repeat":
                rounds = self.number(node, "num_cycles", _MOST)
                return [step for _ in range(rounds) for step in self.steps(self.only(node), plan)]
            case "IfThenElse":
                return self.choice(node, plan)
            case "AlwaysSuccess":
                return []
            case _:
                return [self.call(node, plan).step()]

    def branch(self, node: Element, plan: _Plan) -> Value:
        steps = self.steps(node, plan)
        return steps[0] if len(steps) == 1 else items(steps)

    def choice(self, node: Element, plan: _Plan) -> list[YamlMapping]:
        """Return the steps of a choice by whether a node succeeds: that is kept in a variable."""
        if len(node.contents) not in (2, 3):
            raise InputError(f"<IfThenElse> has {len(node.contents)} nodes; expected two or three", node.position)
        if len(node.contents) == 2:  # it fails as its first node does
            return [step for child in node.contents for step in self.steps(child, plan)]
        asked = self.plain(node.contents[0], plan)
        plan.parts += 1
        variable = f"failed_{plan.parts}"
        self.plans.setdefault(_KEEP, _Plan(_KEEP))

        def kept(value: str) -> YamlMapping:
            update = single("LocalUpdate", items((variable, Bare(value)), short=True), short=True)
            return single(_KEEP, single("operation", update, short=True))

        asked.then = [kept("true"), "skip_action"]
        has_failed = single(
            "Comparison", items(("eq", items((single("LocalQuery", variable, short=True), Bare("true")), short=True)), short=True)
        )
        then, otherwise = (items(self.steps(child, plan)) for child in node.contents[1:])
        return [kept("false"), asked.step(), YamlMapping((Entry(has_failed, "if"), Entry(otherwise, "then"), Entry(then, "else")))]

    def plain(self, node: Element, plan: _Plan) -> _Call:
        """Return a node as a call with nothing around it: of a plan of its own, if need be."""
        if self.is_leaf(node) or node.tag == "SubTree":
            return self.call(node, plan)
        return self.part(plan, node)

    def part(self, plan: _Plan, *nodes: Element) -> _Call:
        """Return the call of a plan that is made of some nodes, which has the variables of the other one."""
        plan.parts += 1
        while (name := f"{plan.name}_{plan.parts}") in self.trees:
            plan.parts += 1
        made = self.plan_of(name, *nodes)
        plan.used.update({variable: None for variable in made.used if variable not in plan.stored})
        plan.stored.update(made.stored)
        return _Call(made.name, {name: single("LocalQuery", name, short=True) for name in made.used})

    def call(self, node: Element, plan: _Plan) -> _Call:
        """Return a node as a call."""
        match node.tag:
            case "RetryUntilSuccessful":
                call = self.plain(self.only(node), plan)
                call.retries = self.number(node, "num_attempts", 10_000) - 1
            case "Timeout":
                call = self.plain(self.only(node), plan)
                call.timeout = self.number(node, "msec", 10**9) / 1000
            case "ForceSuccess":
                call = self.plain(self.only(node), plan)
                call.then = ["skip_action"]
            case "Fallback":
                if not node.contents:
                    raise InputError("<Fallback> has no node", node.position)
                call, rest = self.plain(node.contents[0], plan), node.contents[1:]
                if len(rest) == 1 and rest[0].tag == "Sequence" and rest[0].contents:
                    rest = [rest[0]] if rest[0].contents[-1].tag != "AlwaysFailure" else rest[0].contents
                    fails = rest[-1].tag == "AlwaysFailure"
                    others = rest[: len(rest) - fails]
                    call.then = [self.part(plan, *others).step()] if others else []
                    call.then.append("fail" if fails else "skip_action")
                elif len(rest) == 1:
                    call.then = ["fail"] if rest[0].tag == "AlwaysFailure" else [*self.steps(rest[0], plan), "skip_action"]
                elif rest:
                    others = [Element("Fallback", "", {}, node.position, contents=rest)]
                    call.then = [self.part(plan, *others).step(), "skip_action"]
            case "SubTree":
                return self.subtree(node, plan)
            case _ if self.is_leaf(node):
                return self.leaf(node, plan)
            case _:
                return self.part(plan, node)
        return call

    def is_leaf(self, node: Element) -> bool:
        """Return whether a node is that of an action; refuse what is not read."""
        if node.tag in _REFUSED:
            raise InputError(f"<{node.tag}> is not read: {_REFUSED[node.tag]}", node.position)
        if node.tag in _CONTROL:
            return False
        name = node.of("ID") if node.tag in ("Action", "Condition") else node.tag
        if node.contents or node.tag in ("Control", "Decorator"):
            hint = suggestion(name, _CONTROL)
            raise InputError(f"<{node.tag}> has nodes inside, and is not known{hint and f'; {hint}'}", node.position)
        if self.models and name not in self.models:
            raise InputError(
                f"{name!r} is not in the <TreeNodesModel>; {suggestion(name, [*self.models, *_CONTROL])}".rstrip("; "), node.position
            )
        return True

    def leaf(self, node: Element, plan: _Plan) -> _Call:
        """Return the call of an action."""
        name = node.of("ID") if node.tag in ("Action", "Condition") else node.tag
        if name in RESERVED or name in self.trees or name == _KEEP:
            raise InputError(f"an action cannot be called {name!r} in a plan", node.position)
        ports = {} if name not in self.models else {port.of("name"): port for port in self.models[name].contents}
        if both := next((port for port, its in ports.items() if its.tag == "inout_port"), ""):
            raise InputError(f"{both!r} of {name!r} is an inout_port; expected an input_port and an output_port", ports[both].position)
        arguments, stored = dict[str, Value](), dict[str, str]()
        for port, text in self.ports(node, name):
            if port in ports and ports[port].tag == "output_port":
                stored[port] = self.variable(text, node)
                plan.stored[stored[port]] = None
            else:
                arguments[port] = self.value(text, plan, node)
        self.actions.setdefault(name, {}).update(dict.fromkeys(arguments))
        return _Call(name, arguments, stored)

    def subtree(self, node: Element, plan: _Plan) -> _Call:
        """Return the call of another tree."""
        name = node.of("ID")
        if name not in self.trees:
            raise InputError(f"there is no tree {name!r}; {suggestion(name, self.trees)}".rstrip("; "), node.position)
        if node.attributes.get("_autoremap", "false").lower() in ("1", "true"):
            raise InputError("_autoremap is not read; expected each variable of the tree as an attribute", node.position)
        if name in self.open:
            raise InputError(f"the tree {name!r} calls itself", node.position)
        made = self.plan_of(name, self.trees[name])
        texts = dict(self.ports(node, name))
        given = {port: self.value(text, plan, node) for port, text in texts.items() if port in made.used}
        if missing := [variable for variable in made.used if variable not in given]:
            raise InputError(f"the tree {name!r} asks for {missing[0]!r}, which <SubTree> does not give", node.position)
        stored = {port: self.variable(text, node) for port, text in texts.items() if port in made.stored and text.startswith("{")}
        plan.stored.update(dict.fromkeys(stored.values()))
        # what it does not give on has a name that nobody asks for, or else it would be the caller's variable of the same name
        return _Call(name, given, {port: stored.get(port, f"{name}_{port}_of_its_own") for port in made.stored})

    def ports(self, node: Element, name: str) -> Iterator[tuple[str, str]]:
        """Yield the ports of a node, and their texts: those of the model that it does not give have their defaults."""
        for key, text in node.attributes.items():
            if key in ("_skipIf", "_failureIf", "_successIf", "_while", "_onSuccess", "_onFailure", "_onHalted", "_post"):
                raise InputError(f"{key} is not read: scripts are no part of a plan", node.position)
            if not (key in ("ID", "name") or key.startswith("_")):
                yield key, text
        for port in self.models[name].contents if name in self.models else ():
            if port.of("name") not in node.attributes and "default" in port.attributes:
                yield port.of("name"), port.of("default")

    def variable(self, text: str, node: Element) -> str:
        """Return the name of a variable in braces."""
        if not re.fullmatch(r"\{[A-Za-z_]\w*\}", text):
            raise InputError(f"{text!r} is not read; expected the name of a variable in braces", node.position)
        return text[1:-1]

    def value(self, text: str, plan: _Plan, node: Element) -> Value:
        """Return the value of a port: a variable in braces, or a literal."""
        if text.startswith("{") and text.endswith("}"):
            variable = self.variable(text, node)
            if variable not in plan.stored:
                plan.used[variable] = None
            return single("LocalQuery", variable, short=True)
        return Bare(text) if re.fullmatch(r"-?(0|[1-9][0-9]{0,14})(\.[0-9]{1,15})?", text) else text

    def only(self, node: Element) -> Element:
        """Return the one node inside of another."""
        if len(node.contents) != 1:
            raise InputError(f"<{node.tag}> has {len(node.contents)} nodes; expected one", node.position)
        return node.contents[0]

    def number(self, node: Element, name: str, most: int) -> int:
        """Return a number from 1 of an attribute."""
        text = node.of(name)
        if not (text.isascii() and text.isdecimal() and len(text) < 12 and 1 <= int(text) <= most):
            raise InputError(f"{name} of <{node.tag}> is {text!r}; expected a number from 1 to {most}", node.position)
        return int(text)


def read_tree(text: str, file: str) -> str:
    """Return the trees of a file as plans in YAML, the main one first; raise `InputError`, with line and column, if they are none."""
    root = read_xml(text, file)
    try:
        return _TreeReader(root).text()
    except RecursionError as error:
        raise InputError("trees are nested too deeply", root.position) from error
