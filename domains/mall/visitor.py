"""Visitors of the mall, who ask for the way, interrupt, chat, and answer when they feel like it. Run as a script.

    visitor.py SCRIPTS      a JSON file, see below

    {"late": 0.3, "patience": 2.0, "scripts": [{"name": "1", "visitor": "ann", "requests": [
        {"shop": "shop_0", "replies": ["no", "late"]},
        {"topic": "films", "turns": 2, "replies": ["silent"], "on": "describe_route", "after": 0.1}]}]}

Scripts are played one after the other, each to the end of all its requests. A request is a goal for the node, of a higher
priority than those before; it is sent `after` some seconds from when the robot begins to do something for the request
before (`on`: the name of the action, or `question`), or when `patience` is over. Replies are to the questions of the
request, in order: `now`; `late`, when the robot talks about something else, or after so many seconds; `no`, which is now,
too; `silent`, which is never; what is not said is `now`. Every answer is another text, so that it can be told where it went.

All that is seen is printed, a JSON object per line.
"""

from __future__ import annotations

import heapq
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import rclpy
from pnm_interfaces.action import AchieveGoal, ExecutePlan
from pnm_interfaces.msg import Answer, ExecutorStatus, Question, TaskStatus, TraceEvent
from pnm_interfaces.srv import QueryFacts
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile

FOUND = 60.0
"""Seconds in which the node has to be found."""
STUCK = 60.0
"""Seconds that a script may take."""
LAST = 10.0
"""Seconds in which the last states of tasks are told."""
REPEATED = 0.3
"""Seconds after which an answer is given once more."""
STATES = {value: name for name, value in vars(TaskStatus).items() if name.isupper() and isinstance(value, int)}


@dataclass(eq=False)
class Request:
    """What a visitor wants, and how that goes."""

    wish: dict[str, Any]
    visitor: str
    priority: int
    id: str = ""
    asked: int = 0
    """How many questions there were."""
    is_over: bool = False

    @property
    def about(self) -> str:
        """The shop or the topic: what is said about the request has this word in it."""
        return str(self.wish.get("shop") or self.wish["topic"])

    def reply(self) -> str:
        """Return how the next question is to be answered."""
        replies = self.wish.get("replies", [])
        self.asked += 1
        return str(replies[self.asked - 1]) if self.asked <= len(replies) else "now"


@dataclass
class Visitor:
    """Plays scripts. All fields but the first three change."""

    node: Any
    late: float
    patience: float
    requests: list[Request] = field(default_factory=list)
    waiting: list[tuple[str, Request]] = field(default_factory=list)
    """Requests to be sent once the robot does something."""
    held: dict[str, tuple[Request, str]] = field(default_factory=dict)
    """Answers to open questions that are late."""
    given: dict[str, Answer] = field(default_factory=dict)
    """Answers to open questions."""
    heard: set[str] = field(default_factory=set)
    """Questions that were heard: those of a node that has just found us come twice."""
    states: dict[str, tuple[str, str]] = field(default_factory=dict)
    timers: list[tuple[float, int, Callable[[], None]]] = field(default_factory=list)
    numbers: Any = field(default_factory=count)

    def __post_init__(self) -> None:
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        deep = QoSProfile(depth=1000)
        self.guide = ActionClient(self.node, AchieveGoal, "achieve_goal")
        self.plan = ActionClient(self.node, ExecutePlan, "execute_plan")
        self.answers = self.node.create_publisher(Answer, "knowledge/answers", deep)
        self.arrivals = self.node.create_publisher(TraceEvent, "mall/visitor", 10)
        self.node.create_subscription(Question, "knowledge/questions", self.asked, latched)
        self.node.create_subscription(TraceEvent, "mall/doings", self.seen, deep)
        self.node.create_subscription(TraceEvent, "executor/trace", self.traced, deep)
        self.node.create_subscription(ExecutorStatus, "executor/status", self.told, latched)
        self.query = self.node.create_client(QueryFacts, "knowledge/query")

    # what is done

    def meet(self) -> None:
        """Wait until the node answers, and the robot hears who arrives and is heard.

        The first answers of a node that has not found us yet get lost: those to a question do no harm.
        """
        until = time.monotonic() + FOUND
        while time.monotonic() < until:
            is_robot_there = self.arrivals.get_subscription_count() and self.node.count_publishers("mall/doings")
            if is_robot_there and self.query.service_is_ready() and self.guide.server_is_ready() and self.plan.server_is_ready():
                answer = self.query.call_async(QueryFacts.Request())
                rclpy.spin_until_future_complete(self.node, answer, timeout_sec=1.0)
                if answer.done():
                    return
            rclpy.spin_once(self.node, timeout_sec=0.1)
        sys.exit("there is no node that pursues goals, or no robot")

    def play(self, script: dict[str, Any]) -> None:
        """Play a script to its end."""
        self.say("script", script["name"], visitor=script["visitor"])
        self.arrivals.publish(TraceEvent(word="visitor", subject=script["visitor"]))
        self.requests = [Request(wish, script["visitor"], number) for number, wish in enumerate(script["requests"])]
        self.waiting, self.held = [], {}
        self.send(self.requests[0])
        until = time.monotonic() + STUCK
        while not all(request.is_over for request in self.requests) and time.monotonic() < until:
            self.spin(0.02)
            while self.timers and self.timers[0][0] <= time.monotonic():
                heapq.heappop(self.timers)[2]()
        self.say("end", script["name"], stuck=[request.about for request in self.requests if not request.is_over])

    def spin(self, seconds: float) -> None:
        """Hear what there is to hear."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def later(self, seconds: float, do: Callable[[], None]) -> None:
        """Do something later."""
        heapq.heappush(self.timers, (time.monotonic() + seconds, next(self.numbers), do))

    def send(self, request: Request) -> None:
        """Send the goal of a request, and get the next request ready; a request is sent once."""
        if request.id:
            return
        request.id = "sent"
        if "shop" in request.wish:
            client, goal = self.guide, AchieveGoal.Goal(goal=f"(understood {request.visitor} {request.about})")
        else:
            parameters = json.dumps({"topic": request.about, "turns": request.wish.get("turns", 1)})
            client, goal = self.plan, ExecutePlan.Goal(plan="small_talk", parameters=parameters)
        goal.priority = request.priority
        sent = client.send_goal_async(goal)
        sent.add_done_callback(lambda future: self.accepted(request, future.result()))
        self.say("request", request.about, priority=request.priority)
        following = self.requests[request.priority + 1 : request.priority + 2]
        for one in following:
            self.waiting.append((one.wish.get("on", ""), one))
            self.later(self.patience if one.wish.get("on") else one.wish.get("after", 0.0), lambda one=one: self.send(one))

    def accepted(self, request: Request, handle: Any) -> None:
        """Note the id of the task."""
        request.id = bytes(handle.goal_id.uuid).hex()
        self.say("accepted", request.about, task=request.id, accepted=handle.accepted)
        request.is_over = not handle.accepted
        if handle.accepted:
            handle.get_result_async().add_done_callback(lambda future: self.ended(request, future.result()))

    def ended(self, request: Request, answer: Any) -> None:
        """Note how a task ended."""
        told = answer.result
        results = json.loads(getattr(told, "results", "") or "{}")
        self.say("result", request.about, status=answer.status, reason=told.reason, message=told.message, results=results)
        request.is_over = True

    def answer(self, question: str, request: Request, word: str) -> None:
        """Answer a question, with words that no other answer has."""
        self.held.pop(question, None)
        value = f"{word} {next(self.numbers)}"
        self.given[question] = Answer(id=question, value=json.dumps(value))
        self.say("answer", request.about, question=question, value=value)
        self.publish(question)

    def publish(self, question: str) -> None:
        """Publish an answer until it is no longer needed: the first one may be lost, and one too many does no harm."""
        if question in self.given:
            self.answers.publish(self.given[question])
            self.later(REPEATED, lambda: self.publish(question))

    def see_all_over(self) -> None:
        """Hear how the tasks of the last script have ended, which is told a moment after their results."""
        until = time.monotonic() + LAST
        ids = {request.id for request in self.requests if request.is_over}
        while time.monotonic() < until and not all(self.states.get(id, ("", ""))[0] == "OVER" for id in ids):
            self.spin(0.02)

    # what is seen

    def asked(self, message: Question) -> None:
        """Reply to a question, or hear that no answer is needed any more."""
        if message.kind == Question.WITHDRAW:
            self.held.pop(message.id, None)
            self.given.pop(message.id, None)
            self.say("withdrawn", "", question=message.id)
            return
        request = next((one for one in self.requests if one.about in message.text), None)
        if message.kind != Question.ASK or request is None or message.id in self.heard:
            return
        self.heard.add(message.id)
        reply = request.reply()
        self.say("question", request.about, question=message.id, text=message.text, reply=reply)
        word = "no" if reply == "no" else "yes" if "shop" in request.wish else f"I like {request.about}"
        if reply == "late":
            self.held[message.id] = request, word
            self.later(self.late, lambda: self.answer(message.id, request, word) if message.id in self.held else None)
        elif reply != "silent":
            self.answer(message.id, request, word)
        self.trigger("question", request)

    def seen(self, message: TraceEvent) -> None:
        """See what the robot does: reply late when it talks about something else, send what was to come now."""
        self.say("robot", message.subject, did=message.word, outcome=message.text)
        if message.word != "start":
            return
        name = message.subject.partition("(")[0]
        request = next((one for one in self.requests if one.about in message.subject), None)
        if name in ("describe_route", "ask_understood", "say"):
            for question, (other, word) in tuple(self.held.items()):
                if other is not request:
                    self.answer(question, other, word)
        if request is not None:
            self.trigger(name, request)

    def trigger(self, what: str, request: Request) -> None:
        """Send the request that was to come after this."""
        for name, one in tuple(self.waiting):
            if name == what and self.requests[one.priority - 1] is request:
                self.waiting.remove((name, one))
                self.later(one.wish.get("after", 0.0), lambda one=one: self.send(one))

    def traced(self, message: TraceEvent) -> None:
        """See what happens to tasks."""
        if message.word != "fired":  # transitions are many
            self.say("trace", message.subject, task=bytes(message.task.uuid).hex(), kind=message.word, text=message.text)

    def told(self, message: ExecutorStatus) -> None:
        """See how tasks are doing."""
        for task in message.tasks:
            id, state = bytes(task.id.uuid).hex(), (STATES[task.state], task.reason)
            if self.states.get(id) != state:
                self.states[id] = state
                self.say("state", task.goal, task=id, state=state[0], reason=task.reason)

    def say(self, event: str, about: str, **fields: Any) -> None:
        """Print what is seen or done."""
        sys.stdout.write(json.dumps({"time": round(time.time(), 4), "event": event, "about": about, **fields}) + "\n")
        sys.stdout.flush()


def main(file: str) -> None:
    """Play all scripts of a file."""
    told = json.loads(Path(file).read_text(encoding="utf-8"))
    rclpy.init()
    visitor = Visitor(rclpy.create_node("mall_visitor"), told["late"], told["patience"])
    visitor.meet()
    sys.stdout.write("ready\n")
    for script in told["scripts"]:
        visitor.play(script)
    visitor.see_all_over()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
