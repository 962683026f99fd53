"""The branching net of a policy: a place for each step, the goal, failure and no way out; a transition for each way on from a step.

It is the net of the whole policy, to draw, export and prove: what is carried out are the machines of its stretches. One token is where the
policy is. A call that fails for good, or the last outcome of as many as a task may have, leads to the failure.

The *distance* of a step is the argument that it ends: one of its outcomes leads nearer, whatever was before. The others count as bad luck,
which may come about as often as one likes, but not always.

The pictures leave failure out: for Graphviz, and as SVG with a line for each step and each of its outcomes, and arrows to what follows.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any, Final, NamedTuple, TypeAlias

from planner_bridge.planning.policies.policy import Policy
from planner_bridge.planning.policies.steps import GOAL, MOST, NO_WAY_OUT, Step
from pnm.core.execution.call_results import CallResult
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.verification.explore import explore_part
from pnm.core.machine.verification.part import Count, Inside, Left, Part, PartStep, Unsound
from pnm.core.net.net import Marking, NetBuilder, PetriNet
from pnm.core.pictures.export import COLOURS, quoted
from pnm.core.pictures.xml_text import cut, picture, xml
from pnm.errors import InputError, counted

FAILURE: Final = -2
_NAMES: Final = {GOAL: "goal", NO_WAY_OUT: "no way out", FAILURE: "failure"}
_ROLES: Final = {"goal": "goal", "no way out": "failure", "failure": "failure"}
_LUCK: Final = Count("luck", frozenset(), frozenset(Left), restores=False)


PolicyRun: TypeAlias = tuple[KnowledgeBase, Sequence[CallResult], bool]
"""A run that a policy has planned: the state in which it began, what became of its calls, whether it is over."""


class PolicyWay(NamedTuple):
    """A transition of the net: what it stands for."""

    step: Step
    outcome: str
    """Empty if the call fails."""
    chance: float | None
    then: tuple[int, ...]
    """The steps to which the outcome may lead, by number, those of other transitions included."""

    @staticmethod
    def all_from(step: Step) -> Iterator[PolicyWay]:
        """Yield the ways on from a step: its outcomes, and its failure."""
        for one in step.branches:
            yield PolicyWay(step, one.outcome if len(step.branches) > 1 else "done", one.chance, one.then)
        yield PolicyWay(step, "", None, (FAILURE,))


@dataclass(frozen=True)
class PolicyNet:
    """The net of the steps of a policy.

    Raises an `InputError` if they are too many.
    """

    steps: Sequence[Step]

    def __post_init__(self) -> None:
        if len(self.steps) > MOST:
            raise InputError(
                f"the policy has {len(self.steps)} steps, and there are nets of {MOST} at most; `pnm plan` prints its beginning"
            )

    @cached_property
    def places(self) -> dict[int, str]:
        """The names of the places, by the number of the step."""
        reached = {number for step in self.steps for branch in step.branches for number in branch.then}
        ends = {number: name for number, name in _NAMES.items() if number != NO_WAY_OUT or number in reached}
        return {step.number: f"#{step.number} {step.action}" for step in self.steps} | ends

    @cached_property
    def _built(self) -> tuple[PetriNet, dict[str, PolicyWay]]:
        builder, ways = NetBuilder(), dict[str, PolicyWay]()
        for place in self.places.values():
            builder.place(place)
        for step in self.steps:
            for number, way in enumerate(PolicyWay.all_from(step), 1):
                for then in way.then:
                    to = f" -> {_NAMES.get(then, f'#{then}')}" if len(way.then) > 1 else ""
                    title = f"#{step.number}.{number} {way.outcome}{to}" if way.outcome else f"#{step.number} fails"
                    ways[builder.transition(title, [self.places[step.number]], [self.places[then]])] = way
        return builder.build(), ways

    @property
    def net(self) -> PetriNet:
        """Places and transitions."""
        return self._built[0]

    @property
    def ways(self) -> dict[str, PolicyWay]:
        """What each transition stands for."""
        return self._built[1]

    @property
    def initial(self) -> Marking:
        """The marking at the beginning."""
        return Marking([self.places[self.steps[0].number if self.steps else GOAL]])

    def distances(self, ends: Iterable[int]) -> dict[int, int]:
        """Return the fewest calls from steps to one of the ends, with luck, whatever was before; steps without such a way are left out."""
        found = dict.fromkeys(ends, 0)
        for distance in range(1, len(self.steps) + 1):
            left = (step for step in self.steps if step.number not in found)
            near = [step.number for step in left if any(found.keys() >= {*one.then} for one in step.branches)]
            found |= dict.fromkeys(near, distance)
        return found

    def unproved(self, ends: Collection[int]) -> str:
        """Return why it may go on for ever without luck running out, or stop elsewhere than at these ends; empty if it does not.

        No call fails if failure is none of them.
        """
        net, places, distances = self.net, self.places, self.distances(end for end in ends if end != FAILURE)
        ways = [way for step in self.steps for way in PolicyWay.all_from(step)]
        needed = {(way, (places[way.step.number], 1), (places[then], 1)) for way in ways for then in way.then}
        if needed ^ {(way, *net.inputs[name].items(), *net.outputs[name].items()) for name, way in self.ways.items()}:
            return "the net is not that of its steps"

        def comes_nearer(way: PolicyWay) -> bool:
            return all(number in distances and distances[number] < distances.get(way.step.number, 0) for number in way.then)

        steps = tuple(
            PartStep(name, Inside(), net.inputs[name], net.outputs[name], counted=None if comes_nearer(way) else _LUCK)
            for name, way in self.ways.items()
            if way.outcome or FAILURE in ends
        )
        finals = frozenset(places[end] for end in ends if end in places)
        try:
            explore_part(Part(places=tuple(net.places), steps=steps, initial=self.initial, finals=finals))
        except Unsound as error:
            return str(error)
        return ""

    @cached_property
    def is_sure(self) -> bool:
        """Whether it ends in the goal if no call fails and every outcome comes up sooner or later."""
        return NO_WAY_OUT not in self.places and not self.unproved((GOAL,)) and not self.unproved((GOAL, FAILURE))

    @cached_property
    def claim(self) -> str:
        """What is proved of it, in words."""
        if self.is_sure:
            fair = "in the goal if no call fails and each comes up sooner or later"
            return f"proved: whatever the outcomes, it ends in the goal or in a failure; {fair}"
        if reason := self.unproved((GOAL, FAILURE, NO_WAY_OUT)):
            return f"not proved: {reason}"
        return "proved: whatever the outcomes, it ends in the goal, in a failure, or without a way out"

    def as_data(self) -> dict[str, Any]:
        """Return the net as plain data, with the keys that those of machines have."""
        distances, tokens = self.distances([GOAL]), self.initial
        return {
            "steps": [step.as_json() | {"distance": distances.get(step.number)} for step in self.steps],
            "places": [{"name": place, "role": _ROLES.get(place, ""), "tokens": tokens[place]} for place in self.net.places],
            "transitions": [
                {"name": name, "event": way.outcome or "fails", "step": way.step.number, "chance": way.chance}
                for name, way in self.ways.items()
            ],
            "arcs": [{"source": arc.source, "target": arc.target, "weight": arc.weight} for arc in self.net.arcs],
            "goal_places": [self.places[GOAL]],
            "claim": self.claim,
        }

    def as_json(self) -> str:
        """Return the net as one JSON object."""
        return json.dumps(self.as_data(), indent=1, ensure_ascii=False) + "\n"

    def dot(self) -> str:
        """Return the picture for Graphviz: places round, transitions square."""
        lines = ["digraph policy {", '  rankdir=LR; node [fontname="sans-serif", fontsize=10];']
        for place in self.net.places:
            label = quoted(f"{place}{' •' * self.initial[place]}")
            lines.append(f"  {quoted(place)} [shape=circle, label={label}, color={quoted(COLOURS[_ROLES.get(place, '')])}];")
        for name, way in self.ways.items():
            label = f"{way.outcome} {way.chance:.0%}" if way.chance is not None and way.chance < 1.0 else way.outcome or "fails"
            lines.append(f"  {quoted(name)} [shape=box, height=0.2, label={quoted(label)}];")
        lines += (f"  {quoted(arc.source)} -> {quoted(arc.target)};" for arc in self.net.arcs)
        return "\n".join((*lines, "}", ""))


# --- pictures of the steps ---------------------------------------------------------------------


_ROW: Final = 22
"""Pixels of a line."""
_LETTER: Final = 7
"""Pixels of a letter."""
_MARGIN: Final = 24
_LETTERS: Final = 44
_BEND: Final = (24, 7, 300)
"""Pixels that an arrow bends to the right: at least, for each line that it passes, and at most."""
_TAKEN: Final = ' class="taken"'
_LOOKS: Final = {GOAL: "goal", NO_WAY_OUT: "lost"}
_STYLE: Final = (
    "text{font:11px sans-serif;fill:#263238}.name{font-weight:bold}.bar{fill:#263238}"
    f"circle{{fill:#fff;stroke:{COLOURS['']};stroke-width:1.5px}}.goal{{stroke:{COLOURS['goal']}}}.lost{{stroke:{COLOURS['failure']}}}"
    "path{fill:none;stroke:#78909c}.back{stroke-dasharray:4 3}"
)


class TakenBranch(NamedTuple):
    """A branch that was taken: an outcome of a step, and the step that followed; empty and None if it is not known which."""

    step: int
    outcome: str
    then: int | None


def steps_svg(steps: Sequence[Step], title: str, taken: Iterable[TakenBranch] = (), now: int | None = None, *, style: str = _STYLE) -> str:
    """Return the picture of a policy; the same steps give the same text. Of many steps the first ones are drawn.

    Args:
        taken: the branches that were taken: they are of the class ``taken``.
        now: the step that is under way, of the class ``now``.
        style: as for `picture`.
    """
    ways = {*(taken := [*taken])}
    times = Counter(chain.from_iterable(((one.step, None), (one.step, one.outcome)) for one in taken))
    shown, ends = steps[:MOST], {GOAL: "goal"}
    if any(NO_WAY_OUT in branch.then for step in shown for branch in step.branches):
        ends[NO_WAY_OUT] = "no way out"
    if len(steps) > MOST:
        ends[MOST + 1] = counted(len(steps) - MOST, "more step")

    def text(words: str, step: Step, outcome: str | None = None) -> str:
        count = times[step.number, outcome]
        return f"{words}{' ✓' * (count > 0 and outcome is not None)}{f' {count}×' * (count > 1)}"

    texts = {step.number: text(cut(f"#{step.number} {step.action}", _LETTERS), step) for step in shown}
    labels = {
        (step.number, way.outcome): text(f"{cut(way.outcome, _LETTERS)} {way.chance:.0%}", step, way.outcome)
        for step in shown
        for way in step.branches
        if len(step.branches) > 1
    }
    right, widest = 2 * _MARGIN + _LETTER * max(map(len, (*ends.values(), *texts.values(), *labels.values()))), 0
    rows, y = dict[int, int](), _MARGIN
    for step in shown:
        rows[step.number] = y
        y += _ROW * (1 + len(step.branches) * (len(step.branches) > 1))
    drawn, lit = list[str](), list[str]()
    for end, name in ends.items():
        rows[end], y = y, y + _ROW
        look = f"{_LOOKS.get(end, '')}{' taken' * any(one.then == end for one in taken)}"
        drawn.append(f'<circle class="{look}" cx="{_MARGIN}" cy="{rows[end]}" r="7"/>')
        drawn.append(f'<text class="name" x="{_MARGIN + 14}" y="{rows[end] + 4}">{name}</text>')
    for step in shown:
        top, several = rows[step.number], len(step.branches) > 1
        its, sign = (' class="now"', "▶") if step.number == now else (_TAKEN, "✓") if times[step.number, None] else ("", "")
        drawn.append(f'<g data-step="{step.number}"{its}><title>{xml(f"{step.action}, {step.expected:.1f} calls expected")}</title>')
        name = f'<text class="name" x="{_MARGIN + 14}" y="{top + 4}">{xml(texts[step.number])}</text>'
        name += f'<text class="sign" x="{_MARGIN}" y="{top + 3}">{sign}</text>' if sign else ""
        drawn.append(f'<circle cx="{_MARGIN}" cy="{top}" r="7"/>{name}</g>')
        for line, branch in enumerate(step.branches, 1):
            from_y = top + _ROW * line * several
            if several:
                its, more = (_TAKEN, " taken") if times[step.number, branch.outcome] else ("", "")
                drawn.append(f'<rect class="bar{more}" x="{_MARGIN + 14}" y="{from_y - 5}" width="3" height="10"/>')
                words = xml(labels[step.number, branch.outcome])
                drawn.append(f'<text{its} x="{_MARGIN + 22}" y="{from_y + 4}">{words}</text>')
            for then in branch.then:
                to_y = rows[min(then, MOST + 1)]
                bend = min(_BEND[0] + _BEND[1] * abs(to_y - from_y) // _ROW, _BEND[2])
                widest = max(widest, bend)
                look, is_taken = _LOOKS.get(then, "back" if to_y <= from_y else ""), (step.number, branch.outcome, then) in ways
                way = f"M{right} {from_y}C{right + bend} {from_y} {right + bend} {to_y} {right} {to_y}"
                (lit if is_taken else drawn).append(f'<path class="{look}{" taken" * is_taken}" d="{way}" marker-end="url(#tip)"/>')
    return picture("policy", title, style, right + widest, y, (*drawn, *lit))


def followed(policy: Policy, runs: Iterable[PolicyRun]) -> tuple[list[TakenBranch], int | None]:
    """Return the branches of a policy that runs have taken, in their order, and the step that is under way."""
    steps, taken, now = {step.entry: step for step in policy.steps()}, list[TakenBranch](), None

    def number(state: KnowledgeBase) -> int:
        if evaluate(policy.problem.goal, state) is True:
            return GOAL
        place = policy.place(state)
        return NO_WAY_OUT if place is None or place not in steps else steps[place].number

    for state, results, is_over in runs:
        now = None
        for planned, result in zip(policy.calls(state), results, strict=False):
            step = steps.get(planned.place) if planned else None
            if planned is None or step is None or str(planned.entry) != str(result.call.action):
                break  # something else is done than it says
            if result.is_done:
                after = planned.after.get(result.declared if planned.outcome else "")
                name = step.branches[0].outcome if len(step.branches) == 1 else result.declared
                taken.append(TakenBranch(step.number, name, None if after is None else number(after)))
            elif now is None and not is_over:
                now = step.number
    return taken, now


def followed_words(policy: Policy, taken: Sequence[TakenBranch], now: int | None) -> str:
    """Return what is under way of a policy, what was last and how it came out, and what is to be expected from there."""
    steps = {step.number: step for step in policy.steps()}
    names = {number: f"#{number} {step.action}" for number, step in steps.items()}
    told = [f"under way: {names[now]}"] if now else []
    told += [f"last: {names[one.step]}{f', which came out as {one.outcome}' if one.outcome else ''}" for one in taken[-1:]]
    at = now or (taken[-1].then if taken else next(iter(steps), None))
    if at is not None and (step := steps.get(at)):
        told.append(f"then {policy.entries[step.entry].chance:.1%} to the goal, {step.expected:.1f} {policy.measure} expected")
    return "; ".join(told if taken or now else ["nothing of it has begun", *told])


def followed_svg(policy: Policy, runs: Iterable[PolicyRun]) -> str:
    """Return the picture of a policy, without looks, with what runs have taken of it; its title says the rest."""
    taken, now = followed(policy, runs)
    return steps_svg(policy.steps(), followed_words(policy, taken, now), taken, now, style="")


def steps_dot(steps: Sequence[Step]) -> str:
    """Return the picture of a policy for Graphviz: a box for every step, an arrow for every outcome."""
    lines = ["digraph policy {", '  rankdir=LR; node [shape=box, style=rounded, fontname="sans-serif", fontsize=11];']
    lines += ['  edge [fontname="sans-serif", fontsize=9]; 0 [label="goal", shape=doublecircle]; "-1" [label="no way out", color=red];']
    for step in steps:
        lines.append(f"  {step.number} [label={quoted(f'{step.action}  #{step.number}')}];")
        several = len(step.branches) > 1
        for one in step.branches:
            label = quoted(f"{one.outcome} {one.chance:.0%}" if several else "")
            lines += (f'  {step.number} -> "{number}" [label={label}];' for number in one.then)
    return "\n".join((*lines, "}", ""))
