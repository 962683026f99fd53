"""The problem of a node and the services about it, as `pnm.tasks.ServedWorld`."""

from __future__ import annotations

import asyncio
import os
import re
import threading
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from planner_bridge.explanations.goal_now import packed
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.model.progression import snapshot
from planner_bridge.model.world import with_names_of, world_of_plans
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.reader import MAX_BYTES
from planner_bridge.pipeline.odds import KnownRobots
from planner_bridge.pipeline.roll_outs import SECONDS, odds_of_goal
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.result import code_of_planning
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS
from pnm.clock import in_own_thread
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.errors import InputError
from pnm.files.text import read_any_text, replace_file
from pnm.language.plan import HandWrittenPlan
from pnm.tasks import Code, MadePlan, StepState, TaskStep


def load_texts(domain: str, problem: str, folder: ProblemFolder, loaded: Domain) -> Problem:
    """Return a problem, given as a domain and a problem: each as PDDL, or as the path of a file in the folder.

    An empty domain stands for `loaded`, the current one. Raises an `InputError` if one of them cannot be read.
    """
    for text in (domain, problem):
        if len(text) > MAX_BYTES:
            raise InputError(f"{len(text)} characters; expected {MAX_BYTES} at most")
    chosen = loaded
    if domain.strip():
        chosen = parse_domain(domain, "domain") if _is_pddl(domain) else read_domain(folder.path_of(domain))
    return parse_problem(problem, chosen, "problem") if _is_pddl(problem) else read_problem(folder.path_of(problem), chosen)


def _is_pddl(text: str) -> bool:
    return text.lstrip()[:1] in ("(", ";")


NOTHING: Final = Problem("nothing", Domain("nothing"))
"""The problem of a node that has only hand-written plans."""


class ServedProblem:
    """The problem of a node and the services about it and about what is known, as `pnm.tasks.ServedWorld`: goals are read in it.

    Requests take a while if they are large. So each is worked on in a thread, from a snapshot of what is known when its turn comes,
    while the event loop goes on; and one at a time, because threads share the interpreter with it. The mutable state is the problem,
    and its `world`.

    Args:
        settings: planner and time limit of plan requests.
        folder: where problems are saved, and loaded from.
        begin_anew: has the task manager take over another problem, and the knowledge of its initial state; raises an `InputError` if it
            cannot, and nothing changes.
        plans: hand-written plans; while there is no problem, their declarations are the world's.
        began: when the problem was as its initial state has it, on the clock of the event loop; now if not given.
        check: raises an `InputError` if the robot's action servers and sensors, as they are bound, can never work with a problem;
            returns what is to be done once that is the one.
    """

    def __init__(
        self,
        problem: Problem,
        knowledge: KnowledgeBase,
        settings: Settings,
        folder: ProblemFolder,
        begin_anew: Callable[[Problem, KnowledgeBase], None],
        *,
        goals: Mapping[str, str] | None = None,
        plans: Iterable[HandWrittenPlan] = (),
        began: float | None = None,
        check: Callable[[Problem], Awaitable[Callable[[], Awaitable[None]]]] | None = None,
    ) -> None:
        self._knowledge = knowledge
        self._settings = settings
        self._folder = folder
        self._begin_anew = begin_anew
        self._goals = goals or {}
        self._plans = tuple(plans)
        self._check = check
        self._turn, self._search = asyncio.Lock(), asyncio.Lock()
        self._begin(problem, began)

    def _begin(self, problem: Problem, began: float | None = None) -> None:
        """Read goals in another problem from now on."""
        loop = asyncio.get_running_loop()
        began = loop.time() if began is None else began
        self._is_loaded = problem is not NOTHING
        goals = self._goals if self._is_loaded else {}
        world = problem if self._is_loaded else world_of_plans(self._plans)
        self.world = SharedWorld(world, self._knowledge, goals, elapsed=lambda: loop.time() - began)

    @property
    def problem_world(self) -> SharedWorld:
        """The world of the problem; an `InputError` if there are only plans."""
        if not self._is_loaded:
            raise InputError("no domain and problem are loaded, only plans; expected them when the node starts, or by problem/load")
        return self.world

    def _now(self) -> SharedWorld:
        return self.problem_world.over(snapshot(self._knowledge))

    def _world_of(self, texts: Sequence[str]) -> Callable[[], SharedWorld]:
        """Return what makes the present world in which these texts are read: plans that declare no objects may be asked about any."""
        known = snapshot(self._knowledge)
        if self._is_loaded:
            return lambda: self.world.over(known)
        return lambda: SharedWorld(with_names_of(self.world.problem, self._plans, texts), known)

    def read_goal(self, text: str) -> Condition:
        """Return the goal that a text or a name stands for."""
        return self.problem_world.read_goal(text)

    async def make(self, goal: str, planner: str, seconds: float | None, /, *, with_new_plans: bool = False) -> MadePlan:
        """Search for a plan for a goal, as its text or its name, from the current state; cancelling this ends the planner.

        Plan requests have their turns: a search takes a processor, which robots need. The settings have the planner and the time limit
        of requests that name none.
        """
        async with self._search:
            world, settings, cancel = self.problem_world, self._settings, threading.Event()
            current, planner, timeout = world.current_problem(), planner or settings.planner, seconds or settings.planner_timeout

            def search() -> MadePlan:
                problem = replace(current, goal=world.read_goal(goal))
                result = solve(
                    problem,
                    planner=planner,
                    timeout=timeout,
                    improve=settings.improve,
                    cancel=cancel,
                    executor=settings.executor,
                    bindings=settings.bindings,
                    learned=settings.learned,
                )
                if result.plan is None:
                    return MadePlan(code_of_planning(result.status, ()), result.reason, str(problem.goal))
                before = plan_graph(problem, result.plan).waits_for
                steps = tuple(
                    TaskStep(step.action, step.arguments, step.start, step.duration, StepState.WAITING, tuple(sorted(before[number])))
                    for number, step in enumerate(result.plan.steps)
                )
                odds = None
                if with_new_plans or KnownRobots(settings.learned):
                    limit = SECONDS if with_new_plans else 0.0
                    odds = odds_of_goal(problem, result.plan, settings, NO_FAULTS, policy=result.policy, seconds=limit).told
                return MadePlan(Code.GOAL_REACHED, f"found by {result.planner}", str(problem.goal), steps, odds)

            try:
                return await in_own_thread(search)
            finally:
                cancel.set()

    async def query(self, questions: Sequence[str], /) -> list[tuple[str, str]]:
        """Return the answer to each question, in order; without questions, all facts."""
        async with self._turn:
            world = self._world_of(questions)
            return await asyncio.to_thread(lambda: world().query(questions))

    async def check_goal(self, goal: str, /) -> None:
        """Read a goal; raise an `InputError` if it is none."""
        await asyncio.to_thread(self.read_goal, goal)

    async def pack(self, goal: str, /) -> str:
        """Return the problem as the world is now, with this goal, and the bindings, for another process."""
        async with self._turn:
            world, bindings = self._now(), self._settings.bindings
            return await asyncio.to_thread(lambda: packed(replace(world.current_problem(), goal=world.read_goal(goal)), bindings))

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        """Record all changes or none; return how many facts changed."""
        async with self._turn:
            world = self._world_of((*add, *remove, *forget))
            return self.world.record(await asyncio.to_thread(lambda: world().read_changes(add, remove, forget)))

    async def get(self) -> tuple[str, str]:
        """Return domain and problem in PDDL, the problem with the current state as its initial state."""
        async with self._turn:
            world = self._now()
            return await asyncio.to_thread(lambda: (world.domain_text(), world.problem_text()))

    async def save(self, file: str, /) -> str:
        """Write the problem with the current state to a file in the folder; return its whole path."""
        async with self._turn:
            world = self._now()
            return str(await asyncio.to_thread(lambda: self._folder.write(file, world.problem_text())))

    async def load(self, domain: str, problem: str, /) -> None:
        """Replace domain or problem, and the facts; goals with names must make sense in the new ones as well."""
        async with self._turn:
            known = (self.world if domain.strip() else self.problem_world).problem.domain

            def read() -> tuple[Problem, KnowledgeBase]:
                new = load_texts(domain, problem, self._folder, known)
                initial = initial_knowledge(new)
                SharedWorld(new, initial, self._goals)  # raises what is wrong with the goals
                return new, initial

            new, initial = await asyncio.to_thread(read)
            adopt = await self._check(new) if self._check is not None else None
            self._begin_anew(new, initial)
            self._begin(new)
            if adopt is not None:
                await adopt()

    def follow(self, listener: Callable[[Mapping[str, object]], None], /) -> Callable[[], None]:
        """Pass on every change from now on, as fields of a message; return a function that ends that."""
        self.world.attend()
        return self._knowledge.listen(lambda batch: listener(self.world.changes(batch)) if batch else None)


def served_files(problem: Problem, settings: Settings) -> ServedProblem:
    """Return the world of a problem in which no robot is, to be looked at; on the event loop."""

    def refuse(*_: object) -> None:
        raise InputError("there is no node; only `pnm serve` takes another problem")

    return ServedProblem(problem, initial_knowledge(problem), settings, ProblemFolder(None), refuse)


# --- the folder of problems -----------------------------------------------------------------------
# The folder whose PDDL files the clients of a node load, and to which they save: nothing else can be named, or overwritten.


SUFFIX: Final = ".pddl"
_PROBLEM: Final = re.compile(r"(?:\s|;[^\n]*(?:\n|\Z))*+\(\s*define\s*\(\s*problem\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ProblemFolder:
    """The folder for problems of a node.

    Args:
        root: None if the node has no such folder.
        initial: the file of the problem with which the node begins, which is never overwritten.
    """

    root: Path | None
    initial: Path | None = None

    def __post_init__(self) -> None:
        if self.root is not None and not os.path.isdir(self.root):
            raise InputError(f"there is no folder {str(self.root)!r} for problems; expected one that exists in the parameter 'problems'")

    def path_of(self, name: str) -> Path:
        """Return the path of a PDDL file in the folder, symbolic links resolved; raise an `InputError` for any other."""
        if self.root is None:
            raise InputError("the node has no folder for problems; expected one in its parameter 'problems' when it starts")
        root = self.root.resolve()
        if not name.strip() or "\0" in name:
            raise InputError(f"not a path: {name!r}; expected the path of a file in {root}")
        try:
            path = (root / name).resolve()
        except (OSError, RuntimeError) as error:
            raise InputError(f"not a path: {name[:200]!r} ({error})") from error
        if root not in path.parents:
            raise InputError(f"{name[:200]!r} is not in the folder {root}; expected the path of a file in it")
        if path.suffix != SUFFIX or any(part.startswith(".") for part in path.relative_to(root).parts):
            raise InputError(f"{name[:200]!r} is not the name of a PDDL file; expected one that ends with {SUFFIX}, and no hidden one")
        return path

    def write(self, name: str, problem: str) -> Path:
        """Write a problem to a file atomically, and return its path; raise an `InputError` if it must not, or cannot, be written there."""
        path = self.path_of(name)
        try:
            if self.initial is not None and path.exists() and self.initial.exists() and path.samefile(self.initial):
                raise InputError(f"{path}: cannot be written: the node begins with this problem; expected another name")
            if path.exists() and _PROBLEM.match(read_any_text(path, MAX_BYTES)[0]) is None:
                raise InputError(f"{path}: cannot be written: the existing file is no PDDL problem; expected another name")
            replace_file(path, problem, 0o644)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        return path
