"""What came of scripts, from what was written down: by the robot what it did, by the visitor what she asked for, answered and saw.

Nothing here knows how tasks are carried out; only what must come of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

from tests.support.e2e.mall.scripts import Script

Line = Mapping[str, Any]

SUCCEEDED: Final = 4
SPOKEN: Final = frozenset({"describe_route", "ask_understood", "say"})


@dataclass
class Verdict:
    """What is wrong, and what there was to see."""

    wrong: list[str] = field(default_factory=list)
    scripts: int = 0
    requests: int = 0
    interrupted: int = 0
    """Requests during which the robot spoke about something else, and then about them again."""
    paused: int = 0
    """Tasks that were paused, as the node says."""
    questions: int = 0
    answers: int = 0
    late: int = 0
    """Answers to a question after which the robot had begun to speak about something else."""
    in_vain: int = 0
    """Answers that came when the question was not open any more; it was asked again then."""

    def __str__(self) -> str:
        seen = ", ".join(f"{name} {value}" for name, value in vars(self).items() if name != "wrong")
        return "\n".join((f"{len(self.wrong)} complaints; {seen}", *self.wrong))


@dataclass(frozen=True)
class Doing:
    """Something that the robot did."""

    call: str
    uses: str
    start: float
    end: float
    outcome: str

    @property
    def name(self) -> str:
        """The action."""
        return self.call.partition("(")[0]


def verdict_on(scripts: Sequence[Script], robot: Sequence[Line], visitor: Sequence[Line]) -> Verdict:
    """Return the verdict on scripts that were run one after the other."""
    verdict = Verdict()
    doings = list(_doings(robot, verdict))
    verdict.wrong += _clashes(doings)
    for one in scripts:
        lines = _lines_of(one["name"], visitor)
        if not lines:
            verdict.wrong.append(f"script {one['name']} was not run to its end")
            continue
        verdict.scripts += 1
        begin, end = lines[0]["time"], lines[-1]["time"]
        states = [line for line in visitor if line["event"] == "state"]  # they may come after the end
        _Check(one, [doing for doing in doings if begin <= doing.start <= end], lines, states, verdict).verdict_on()
    return verdict


def _doings(robot: Sequence[Line], verdict: Verdict) -> Iterator[Doing]:
    going_on: dict[str, Line] = {}
    for line in robot:
        call = line["call"]
        if line["event"] == "start":
            if call in going_on:
                verdict.wrong.append(f"{call} was begun twice at the same time")
            going_on[call] = line
        elif call in going_on:
            begun = going_on.pop(call)
            yield Doing(call, begun["uses"], begun["time"], line["time"], line["outcome"])
    verdict.wrong += [f"{call} never ended" for call in going_on]


def _clashes(doings: Iterable[Doing]) -> Iterator[str]:
    for resource in ("voice", "arm"):
        users = sorted((doing for doing in doings if doing.uses == resource), key=lambda doing: doing.start)
        for one, other in pairwise(users):
            if other.start < one.end:
                yield f"{one.call} and {other.call} used the {resource} at the same time"


def _lines_of(name: str, visitor: Sequence[Line]) -> Sequence[Line]:
    """Return the visitor's lines from the begin of a script to its end, or nothing if one is missing.

    By their order: the last line of one script and the first of the next may have the same time.
    """
    places = {line["event"]: place for place, line in enumerate(visitor) if line["event"] in ("script", "end") and line["about"] == name}
    return visitor[places["script"] : places["end"] + 1] if len(places) == 2 else []


@dataclass(frozen=True)
class _Check:
    script: Script
    doings: Sequence[Doing]
    lines: Sequence[Line]
    states: Sequence[Line]
    verdict: Verdict

    def verdict_on(self) -> None:
        for wish in self.script["requests"]:
            about = wish.get("shop") or wish["topic"]
            self.verdict.requests += 1
            self._triggered(wish, about)
            self._answered(wish, about)
            self._repeated(wish, about)
            self._resumed(about)

    def _complain(self, text: str) -> None:
        self.verdict.wrong.append(f"script {self.script['name']}: {text}")

    def _of(self, event: str, about: str) -> list[Line]:
        return [line for line in self.lines if line["event"] == event and line["about"] == about]

    def _triggered(self, wish: Script, about: str) -> None:
        """The right task was begun, and reached its goal."""
        counts = [len(self._of(event, about)) for event in ("request", "accepted", "result")]
        if counts != [1, 1, 1]:
            self._complain(f"{about} was requested, accepted and ended {counts} times")
            return
        (result,) = self._of("result", about)
        if (result["status"], result["reason"]) != (SUCCEEDED, "goal_reached"):
            self._complain(f"{about} ended as {result['status']}, {result['reason']}: {result['message']}")
        (accepted,) = self._of("accepted", about)
        goals = {line["about"] for line in self.states if line["task"] == accepted["task"]}
        expected = about if "shop" in wish else "small_talk"
        if not goals or not all(expected in goal for goal in goals):
            self._complain(f"the request about {about} is the task {', '.join(goals) or 'of nobody'}")
        if not any(about in doing.call and doing.name in SPOKEN for doing in self.doings):
            self._complain(f"nothing was said about {about}")

    def _answered(self, wish: Script, about: str) -> None:
        """Every answer reached its question, and no question got the answer to another one."""
        questions, answers = self._of("question", about), self._of("answer", about)
        self.verdict.questions += len(questions)
        self.verdict.answers += len(answers)
        heard = self._heard(wish, about)
        given = [answer["value"] for answer in answers]
        for value in heard:
            if value not in given:
                self._complain(f"{value!r} reached {about}, but was not said to it")
        for answer in answers:
            asked_again = any(question["time"] > answer["time"] for question in questions)
            if answer["value"] not in heard:
                self.verdict.in_vain += 1
                if not asked_again:
                    self._complain(f"{answer['value']!r} never reached {about}, and it was not asked again")
            self.verdict.late += any(self._is_other(line, about) for line in self._between(answer, questions))

    def _is_other(self, line: Line, about: str) -> bool:
        """Tell whether the robot begins to speak about something else."""
        return line["event"] == "robot" and line["did"] == "start" and about not in line["about"] and line["about"].split("(")[0] in SPOKEN

    def _heard(self, wish: Script, about: str) -> list[str]:
        """Return the answers that reached the task."""
        if "topic" in wish:
            return [value for line in self._of("result", about) for value in line["results"].get("answers", [])]
        return [doing.call.rstrip(")").split(", ")[-1] for doing in self.doings if doing.name == "hear_answer" and about in doing.call]

    def _between(self, answer: Line, questions: Sequence[Line]) -> list[Line]:
        (asked,) = (question["time"] for question in questions if question["question"] == answer["question"])
        return [line for line in self.lines if asked < line["time"] < answer["time"]]

    def _repeated(self, wish: Script, about: str) -> None:
        """What was not understood is described once more, what was not answered is asked once more."""
        replies = [line["reply"] for line in self._of("question", about)]
        if "topic" in wish:
            said = len(self._heard(wish, about))
            if said != wish["turns"]:
                self._complain(f"talk about {about} had {said} turns, not {wish['turns']}")
        own = [doing for doing in self.doings if about in doing.call and doing.outcome == "succeeded"]
        for name in ("describe_route", "point_at") if "shop" in wish else ():
            times = sum(doing.name == name for doing in own)
            if times < 1 + replies.count("no"):
                self._complain(f"{about} had {times} times {name}, and was {replies.count('no')} times not understood")
        if replies and replies[-1] == "silent":
            self._complain(f"about {about} nothing was asked again after silence")

    def _resumed(self, about: str) -> None:
        """What was paused went on, and came to its end."""
        tasks = [line["task"] for line in self._of("accepted", about)]
        states = [line["state"] for line in self.states if line["task"] in tasks]
        self.verdict.paused += "PAUSED" in states
        if states[-1:] == ["PAUSED"]:
            self._complain(f"{about} was paused and never resumed")
        spoken = [about in doing.call for doing in sorted(self.doings, key=lambda doing: doing.start) if doing.name in SPOKEN]
        if True in spoken:
            inner = spoken[spoken.index(True) : len(spoken) - spoken[::-1].index(True)]
            self.verdict.interrupted += False in inner
