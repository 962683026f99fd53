"""The grammar of the YAML language: the keys of domains, problems, actions, plans, steps and worlds, in the order of the pages.

The readers read by these classes, `pnm schema` writes them as a JSON Schema, and the tables of the pages are made of them;
the words of formulas stand in `pnm.language.formulas.words` and `pnm.language.formulas.readers`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from math import inf
from typing import Final, TypeAlias

from pnm.actions.bindings_file import BindingKeys
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import Then
from pnm.files.yaml_keys import (
    ANYTHING,
    TEXT,
    Keys,
    Schema,
    choice,
    each,
    inside,
    listed,
    names,
    needed,
    needed_inside,
    node,
    number,
    ref,
    section,
    text,
    texts,
    whole,
    written,
)
from pnm.language.formulas.words import CONDITION, VALUE

_STEPS: Final = ref("steps")
_TYPED: Final = ref("typed")
_TEXTS: Final = ref("texts")
_RECOVERY: Final = ref("recovery")
_WAITS: Final = ref("waits")
_CONSTRAINTS: Final = ref("constraints")
_PREFERENCES: Final = ref("preferences")
_OF_THE_FIRST: Final = "ignored; files for the original implementation have it"


class ClassName(Keys, schema={"required": ["module", "class"]}):
    """A class of the original implementation; nothing is imported."""

    module = text("the module")
    class_ = text("the class")


_CLASS: Final = ClassName.json(or_null=True)

# --- actions -------------------------------------------------------------------------------


class ActionKind(Enum):
    """The execution of an action."""

    ROS = "ros_action"
    """An action server."""
    RPN = "rpn_action"
    """An action server that asks for knowledge, and changes it, while it runs."""
    KB = "kb_action"
    """Without a server: it works on knowledge alone."""
    PLAN = "plan"
    """Another plan, which is an action server as well."""


_KINDS: Final[Schema] = {"enum": [kind.value for kind in ActionKind if kind is not ActionKind.PLAN]}


class ActionKeys(Keys):
    """The part of an action that is no binding."""

    instances = node(ANYTHING, _OF_THE_FIRST)
    type = node(
        {"type": ["string", "object", "null"], "if": {"type": "string"}, "then": _KINDS, "else": _CLASS},
        "`ros_action`: an action server. `rpn_action`: one that asks for knowledge while it runs. `kb_action`: an operation on knowledge",
        "`ros_action`",
    )
    params = node(_TYPED, "names, `[place, speed]`, or PDDL's text, `?r - robot ?to - place`", "any")
    preconditions = node(ref("conditionByMoment"), "conditions for the start of the call, or by moment", "nothing")
    effects = node(ref("effectsByMoment"), "facts after it, or by moment, and tests of variables", "nothing")
    outcomes = node(ref("outcomes"), "ways in which it may end, of which one happens besides the effects: `{name, chance, effects}`", "one")
    duration = node(ref("duration"), 'seconds: a number, `(distance ?from ?to)`, or bounds `[{"<=": 5}]`', "unknown; 1 s in a rehearsal")
    preferences = listed(_PREFERENCES, "wishes that a planner may leave unfulfilled")
    recoveries = written(ref("recoveries"), "reactions to failures")
    simulated = section(VALUE, "result fields of the simulated server, computed from its goal and from facts", "no result")


class Action(BindingKeys, ActionKeys, schema={"type": ["object", "null"]}):
    """An action."""

    ros_type = BindingKeys.ros_type.named("ros_type")
    told = BindingKeys.told.named("told_by")
    retries = whole(BindingKeys.retries.words, 0)


BINDING_KEYS: Final = tuple(key.name for key in Action.known.values() if key.name not in ActionKeys.known)
"""The keys of an action that bind it to its server."""

# --- processes and events ------------------------------------------------------------------


class ProcessKeys(Keys, schema={"type": ["object", "null"]}):
    """Something that goes on by itself while a condition holds."""

    params = node(_TYPED, "the objects it is about: ?t - tank", "none")
    preconditions = node(CONDITION, "it goes on while they hold", "always")
    effects = needed(ref("effects"), 'by how much numbers change in a second: `increase: ["(level ?t)", 2]`, or `decrease`')


class EventKeys(ProcessKeys):
    """Something that comes about by itself as soon as a condition holds."""

    preconditions = node(CONDITION, "it comes about as soon as they hold").must()
    effects = needed(ref("effects"), "facts after it; they make its preconditions false")


# --- domains and problems ------------------------------------------------------------------


class RuleKeys(Keys):
    """A rule: a fact that follows from others."""

    fact = needed(TEXT, "the fact with its parameters: (reachable ?p - place)")
    condition = needed(CONDITION, "when it is so")


class TimedFacts(Keys):
    """Facts that become so by themselves."""

    at = number("seconds after the beginning", 0.0).must()
    facts = listed(ref("facts"), "facts from then on")


class _PlannedKeys(Keys):
    """The keys of domains and problems that only planners read."""

    requirements = listed(_TEXTS, "PDDL's requirements; for planners")
    constraints = listed(_CONSTRAINTS, "constraints on the course of a plan; for planners")
    preferences = listed(_PREFERENCES, "preferences; for planners")


class ProblemKeys(_PlannedKeys):
    """A problem."""

    name = text("a name")
    objects = node(_TYPED, "the objects: r1 r2 - robot kitchen - place")
    init = listed(
        {"type": ["array", "string", "null"], "items": {"if": {"type": "object"}, "then": TimedFacts.json(), "else": TEXT}},
        "facts at the beginning, and facts that become true by themselves",
    )
    goal = node(CONDITION, "condition at the end")
    metric = node(ref("metric"), "a number to make as small or as large as possible; for planners")
    network = listed({"type": ["string", "null"]}, "a task network as PDDL writes it; for planners")


class DomainKeys(_PlannedKeys, others=ANYTHING):
    """A domain; whatever else its document has is read elsewhere."""

    name = text("a name", "that of the file")
    instances = node(ANYTHING, _OF_THE_FIRST)
    external_knowledge_base = node(
        _CLASS, "the knowledge base as files for the original implementation name it; stands for a registered source"
    )
    knowledge = listed(
        {"type": ["string", "array", "object", "null"], "items": {"type": ["string", "object"]}},
        "sources of knowledge: registered names, or names with options",
    )
    action_types = each(Action, ref("action"), "entries that only carry anchors for actions to merge")
    actions = each(Action, ref("action"), "the actions by name; the name is that of the action server unless the action says otherwise")
    processes = each(ProcessKeys, ProcessKeys.json(), "what goes on by itself, by name")
    events = each(EventKeys, EventKeys.json(), "what comes about by itself, by name")
    types = node(_TYPED, "types and what they are kinds of: robot place - object")
    constants = node(_TYPED, "objects that every problem has: hall kitchen - place")
    predicates = listed(_TEXTS, "predicates: (at ?r - robot ?p - place)")
    functions = listed(_TEXTS, "functions: (battery ?r - robot), or (location ?r - robot) - place")
    derived = listed({"type": ["array", "null"], "items": RuleKeys.json()}, "facts that follow from others")
    hierarchy = listed(_TEXTS, "tasks and methods as PDDL writes them; for planners")
    problem = inside(ProblemKeys, "objects, facts and goal that the domain is used with")


# --- plans and worlds ----------------------------------------------------------------------


class PlanKeys(Keys):
    """The keys of every plan."""

    plan = needed(_STEPS, "the list of steps")
    domain = text("the file of the domain, seen from this file", "this file")
    params = node(
        _TYPED,
        "variables that the caller gives. Each needs a value from the caller, `initial_knowledge` (`null` will do), the global knowledge, "
        "or a person (`ask`) before the plan begins",
        "any",
    )
    results = names("variables that the caller gets at the end", "none")
    initial_knowledge = section(ANYTHING, "variables and their values; parameters come before them", "none")
    facts = listed(ref("facts"), "facts of the world: `(at r1 hall)`, `(= (battery r1) 80)`", "nothing")
    goal = node(CONDITION, "condition at the end", "nothing")
    timeout = number("seconds for the plan", None, "no limit")
    restarts = whole(
        "how often the plan may begin anew by recoveries; one more fails as `restart_limit`", None, "once, or as often as a recovery says"
    )
    on_failure = choice(
        OnFailure,
        "running calls after a failure: `drain` lets them end, `cancel` cancels them, `continue_others` lets them end beside a new plan",
        "`drain`",
    )
    resources = section({"type": ["integer", "null"], "minimum": 1}, "how many calls may share one: `{arm: 2}`", "1 each")


class NamedPlan(PlanKeys, others=ANYTHING):
    """A document with a plan."""

    name = text("of the plan", "that of the file")


class Recipe(PlanKeys):
    """A plan under its name."""

    server = node(_CLASS, _OF_THE_FIRST)
    action = node(_CLASS, _OF_THE_FIRST)


class WorldFile(Keys):
    """A domain and the plans that are offered with it."""

    name = text("a name", "that of the file")
    domain = text("the file of the domain, seen from this file")
    plans = names("the files of the plans, seen from this file")


class NamedWorld(Keys, schema={"required": ["recipes"]}):
    """A world under its name."""

    domain = WorldFile.domain
    plans = WorldFile.plans.named("recipes")


class Document(
    NamedPlan,
    DomainKeys,
    schema={"required": []},
    others={
        "description": "A plan under its name, or a world.",
        "if": {"type": "object", "required": ["recipes"]},
        "then": NamedWorld.json(),
        "else": Recipe.json(),
    },
):
    """Domains, plans and worlds for Petri Net Machines; docs/reference/language.md explains them."""

    plans = WorldFile.plans


# --- steps ---------------------------------------------------------------------------------


class Place(Keys):
    """The position of a step."""

    id = text("a name for the step, for others of the same list to wait for")
    after = written(_WAITS, "ids of the steps that this one waits for, in place of all before it")


class Concurrent(Place):
    """Steps at the same time."""

    steps = needed(_STEPS, "steps at the same time").named("concurrent_actions")


class InSequence(Place):
    """Steps one after the other."""

    steps = needed(_STEPS, "steps one after the other").named("sequence")


class LoopKeys(Keys):
    """Repeats steps as long as a condition holds."""

    condition = needed(CONDITION, "tested before every round")
    actions = needed(_STEPS, "the steps of a round")
    limit = whole("how many rounds at most; the loop fails if the condition holds after that", 1000, least=1, most=1_000_000)


class While(Place):
    """Steps that are repeated."""

    loop = needed_inside(LoopKeys, "repeats steps as long as a condition holds").named("while")


class WaitKeys(Keys):
    """Does nothing until a condition holds."""

    condition = needed(CONDITION, "ends the waiting")
    limit = number("seconds after which the step fails", 0.0).must()


class Waiting(Place):
    """A step that waits for a condition."""

    wait = needed_inside(WaitKeys, "does nothing until a condition holds").named("wait_until")


class If(Place):
    """One of two lists of steps."""

    if_ = needed(CONDITION, "chooses between then and else")
    then = needed(_STEPS, "steps if the condition holds")
    else_ = written(_STEPS, "steps if not")


Block: TypeAlias = Concurrent | InSequence | While | Waiting | If
BLOCKS: Final[Mapping[str, type[Block]]] = {
    "if": If,
    "while": While,
    "wait_until": Waiting,
    "concurrent_actions": Concurrent,
    "sequence": InSequence,
}
"""The steps that are no calls, by the word that they begin with."""
RESERVED: Final = frozenset(name for block in BLOCKS.values() for name in block.known if name not in Place.known)
"""Words that steps begin with."""


class Call(Place, others=ANYTHING):
    """A call of an action, beside the key that names it."""

    recoveries = written(ref("recoveries"), "reactions to failures of this call, in place of those of its action")
    retries = whole("further attempts, without a recovery", None)
    timeout = number("seconds from acceptance to cancellation", None)
    resources = names("exclusive resources, in addition to those of its action")
    store = texts(
        "expected result fields and the variables to store them in",
        "result fields, and the variables that keep them, or the facts and functions that they set",
    )
    end_after = written(_WAITS, "ids of the steps that the end of this call waits for")
    duration = number("seconds for the call, within the bounds of its action", None)
    outcome = text("of an action with several: the one that the next steps are meant for; they check what they need", "the first")
    release = number("seconds after the beginning of the plan; the call does not start before", 0.0)
    latest_start = number("seconds after the beginning of the plan; the call must be sent by then", inf)
    deadline = number("seconds after the beginning of the plan; the call must have ended by then", inf)


class WaitFor(Keys):
    """The start or the end of a step, and for how many seconds after that."""

    start = text("the id of a call that must have started")
    end = text("the id of a step that must have ended")
    delay = number("seconds that must pass after that", 0.0)


# --- recoveries ----------------------------------------------------------------------------


class During(Keys):
    """Recoveries by how the request ended."""

    aborted = node(_RECOVERY, "the server gave up")
    preempted = node(_RECOVERY, "the server says that the action was cancelled; by default the plan goes on")
    rejected = node(_RECOVERY, "the server did not take the goal")
    unavailable = node(_RECOVERY, "no server was there, or it did not answer")
    timed_out = node(_RECOVERY, "it took too long and was cancelled")
    lost = node(_RECOVERY, "the server went away")


class RecoveryKeys(Keys, schema={"type": ["object", "null"]}):
    """Reactions to failures of a call."""

    before = node(_RECOVERY, "when the precondition does not hold or goal data are missing; with when, if that holds before the start")
    during = inside(During, "by how the request ended")
    after = node(_RECOVERY, "when effects are missing; with when, if that holds after success")


class Chain(Keys):
    """A chain with how often it may be used."""

    do = needed(ref("chain"), "steps and a command")
    times = whole("how often each time the call is reached", None, "1", least=1, most=10_000)


class ConditionalChain(Chain):
    """A chain with how often it may be used, and before or after the call, when."""

    when = written(CONDITION, "the chain is for when this holds")


COMMANDS: Final = {**{then.value: then for then in Then}, "restart_action": Then.RETRY}
"""The end of a chain."""
