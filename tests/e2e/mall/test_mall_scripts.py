"""The verdict on the scripts of the mall: no complaint about a log that is as it should be, and one about each that is not."""

from __future__ import annotations

from copy import deepcopy
from itertools import count

import pytest

from tests.support.e2e.mall.scripts import CHAT, GUIDED, script
from tests.support.e2e.mall.verdict import verdict_on


class Told:
    """What would be written down if requests were served one after the other."""

    def __init__(self, *scripts):
        self.robot, self.visitor = [], []
        self._time, self._numbers = count(1), count()
        for one in scripts:
            self._see("script", one["name"])
            for wish in one["requests"]:
                self._serve(one["visitor"], wish)
            self._see("end", one["name"])

    def _see(self, event, about, **fields):
        self.visitor.append({"time": next(self._time), "event": event, "about": about, **fields})

    def _do(self, call, uses="", outcome="succeeded"):
        self.robot.append({"time": next(self._time), "event": "start", "call": call, "uses": uses})
        self.robot.append({"time": next(self._time), "event": "end", "call": call, "uses": uses, "outcome": outcome})

    def _serve(self, visitor, wish):
        about = wish.get("shop") or wish["topic"]
        self._see("request", about)
        self._see("accepted", about, task=about)
        goal = f"(understood {visitor} {about})" if "shop" in wish else "small_talk"
        for state in ("RUNNING", "PAUSED", "RUNNING"):
            self._see("state", goal, task=about, state=state)
        answers = self._guide(visitor, about, wish) if "shop" in wish else self._talk(about, wish)
        self._see("result", about, status=4, reason="goal_reached", message="", results={"answers": answers})
        self._see("state", goal, task=about, state="OVER")

    def _ask(self, about, reply, word):
        number = next(self._numbers)
        self._see("question", about, question=number, reply=reply)
        if reply == "silent":
            return None
        value = f"{'no' if reply == 'no' else word} {number}"
        self._see("answer", about, question=number, value=value)
        return value

    def _guide(self, visitor, shop, wish):
        replies, value = [*wish["replies"], "now"], None
        while value is None or value.startswith("no"):
            if value or len(replies) == len(wish["replies"]) + 1:
                self._do(f"point_at({visitor}, {shop})", "arm")
                self._do(f"describe_route({visitor}, {shop})", "voice")
                self._do(f"ask_understood({visitor}, {shop})", "voice")
            value = self._ask(shop, replies.pop(0), "yes")
            if value:
                self._do(f"hear_answer({visitor}, {shop}, {value})", "", "aborted" if value.startswith("no") else "succeeded")
        return []

    def _talk(self, topic, wish):
        replies, answers = list(wish["replies"]), []
        while len(answers) < wish["turns"]:
            self._do(f"say(What do you like about {topic}?)", "voice")
            value = self._ask(topic, replies.pop(0) if replies else "now", topic)
            answers += [value] if value else []
        return answers


def complaints(scripts, told):
    return verdict_on(scripts, told.robot, told.visitor).wrong


def test_a_number_is_always_the_same_script_and_there_are_all_kinds():
    assert [script(number) for number in range(50)] == [script(number) for number in range(50)]
    wishes = [wish for number in range(200) for wish in script(number)["requests"]]
    assert {tuple(wish["replies"]) for wish in wishes if "shop" in wish} == set(GUIDED)
    assert {reply for wish in wishes if "topic" in wish for reply in wish["replies"]} == set(CHAT)
    assert {len(script(number)["requests"]) for number in range(200)} == {1, 2, 3, 4}


def test_there_is_nothing_to_say_about_what_is_as_it_should_be():
    scripts = [script(number) for number in range(100)]
    verdict = verdict_on(scripts, (told := Told(*scripts)).robot, told.visitor)
    assert not verdict.wrong, str(verdict)
    assert (verdict.scripts, verdict.requests) == (100, sum(len(one["requests"]) for one in scripts))
    assert verdict.in_vain == 0
    assert verdict.answers < verdict.questions


ONE = {
    "name": "1",
    "visitor": "ann",
    "requests": [{"shop": "shop_0", "replies": ["no"]}, {"shop": "shop_1", "replies": []}, {"topic": "films", "turns": 1, "replies": []}],
}


def first(lines, **fields):
    return next(line for line in lines if all(line.get(name) == value for name, value in fields.items()))


def lost_answer(told):
    for line in [line for line in told.robot if line["call"].startswith("hear_answer(ann, shop_1")]:
        told.robot.remove(line)


def swapped_answers(told):
    for line in told.robot:
        if line["call"].startswith("hear_answer"):
            line["call"] = line["call"].replace("shop_0", "shop_").replace("shop_1", "shop_0").replace("shop_,", "shop_1,")


def two_voices(told):
    line = first(told.robot, event="end", call="ask_understood(ann, shop_1)")
    line["time"] = first(told.robot, event="start", call="say(What do you like about films?)")["time"] + 0.5


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lost_answer, "script 1: 'yes 2' never reached shop_1, and it was not asked again"),
        (swapped_answers, "script 1: 'yes 2' reached shop_0, but was not said to it"),
        (two_voices, "ask_understood(ann, shop_1) and say(What do you like about films?) used the voice at the same time"),
        (lambda told: first(told.visitor, event="result", about="shop_1").update(status=6, reason="no_plan"), "shop_1 ended as 6, no_plan"),
        (lambda told: told.visitor.remove(first(told.visitor, event="result", about="films")), "films was requested, accepted and ended"),
        (lambda told: told.visitor.remove(first(told.visitor, event="state", task="shop_0", state="OVER")), ""),
        (lambda told: first(told.visitor, task="films", state="OVER").update(state="PAUSED"), "films was paused and never resumed"),
        (lambda told: first(told.visitor, event="state", task="shop_1").update(about="(understood ann shop_3)"), "is the task"),
        (
            lambda told: first(told.visitor, event="result", about="films")["results"].update(answers=[]),
            "talk about films had 0 turns, not 1",
        ),
        (lambda told: told.visitor.remove(first(told.visitor, event="end", about="1")), "script 1 was not run to its end"),
        (lambda told: told.robot.remove(first(told.robot, event="end", call="point_at(ann, shop_1)")), "point_at(ann, shop_1) never ended"),
        (
            lambda told: first(told.robot, event="end", call="describe_route(ann, shop_0)").update(outcome="canceled"),
            "shop_0 had 1 times describe_route, and was 1 times not understood",
        ),
    ],
)
def test_what_is_wrong_is_found(harm, said):
    told = Told(ONE)
    assert not complaints([ONE], deepcopy(told))
    harm(told)
    wrong = complaints([ONE], told)
    assert any(said in one for one in wrong) if said else not wrong, wrong


def test_a_result_at_the_very_moment_at_which_the_next_script_begins_belongs_to_the_script_before():
    told = Told(ONE, other := {**ONE, "name": "2"})
    begin = first(told.visitor, event="script", about="2")
    for line in told.visitor:
        if line["about"] == "films" and line["event"] == "result" and line["time"] < begin["time"]:
            line["time"] = begin["time"]
    first(told.visitor, event="end", about="1")["time"] = begin["time"]
    assert not complaints([ONE, other], told)
