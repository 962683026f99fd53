"""The numbers of a journal for Prometheus: what has ended is counted as its spans end, the rest is what is so after the last record.

Values of labels are words of ours, or names of the domain, of which there are so many at most: a time series is made for each of them.
"""

from __future__ import annotations

from collections import Counter
from importlib.metadata import version
from threading import Lock
from typing import Final

from planner_bridge.view.follow import Reader
from planner_bridge.view.spans import Span, Spans
from pnm.errors import not_installed
from pnm.files.database.place import Place
from pnm.tasks import TaskState

_NAMES: Final = 200
"""Names of actions and outcomes that are told apart; the others are told together."""
_LONG: Final = 80
"""Characters of a name."""
_SECONDS: Final = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0)
"""Limits of the classes of durations."""


class Metrics:
    """The numbers of a journal, read whenever somebody asks for them. Any thread may call. The mutable state is what was counted so far.

    Raises an `InputError` if an extra is not installed.
    """

    def __init__(self, place: Place) -> None:
        try:
            import prometheus_client as prometheus
        except ModuleNotFoundError as error:
            raise not_installed("this", error, "telemetry") from error
        self._reader = Reader[Spans](place, tells=Spans)
        self._lock = Lock()
        self._counted: Spans | None = None
        """The story that has been counted: another one takes its place when a journal has begun anew."""
        self._names: dict[str, None] = {}
        self.registry = registry = prometheus.CollectorRegistry()
        self._written = prometheus.generate_latest
        prometheus.Info("pnm_build", "The version.", registry=registry).info({"version": version("petri-net-machines")})
        self._tasks = prometheus.Gauge("pnm_tasks", "Tasks that are not over.", ["state"], registry=registry)
        self._questions = prometheus.Gauge("pnm_open_questions", "Questions that nobody has answered yet.", ["asked"], registry=registry)
        self._hands = prometheus.Gauge("pnm_in_hands", "Robots and other things in people's hands.", registry=registry)
        self._last = prometheus.Gauge("pnm_journal_last_record", "The number of the last record of the journal.", registry=registry)
        self._lag = prometheus.Gauge("pnm_journal_lag_records", "Records of the journal that are not told here.", registry=registry)
        self._over = prometheus.Counter("pnm_tasks_over", "Tasks that have ended.", ["code"], registry=registry)
        self._plans = prometheus.Counter("pnm_plans", "Plans whose machines have ended.", ["follows"], registry=registry)
        self._failures = prometheus.Counter("pnm_failures", "Steps that were given up.", ["cause"], registry=registry)
        self._calls = prometheus.Counter("pnm_calls", "Calls that have ended.", ["action", "outcome"], registry=registry)
        self._attempts = prometheus.Counter("pnm_attempts", "Requests that have ended.", ["action", "end"], registry=registry)
        self._durations = prometheus.Histogram(
            "pnm_attempt_seconds", "Seconds from sending a request to its end.", ["action"], registry=registry, buckets=_SECONDS
        )

    def text(self) -> str:
        """Return the numbers as Prometheus reads them; raise a `PnmError` if the journal is not read or replayed."""
        with self._lock:
            self._reader.now(self.tell)
            return self._written(self.registry).decode()

    def close(self) -> None:
        """Read no more."""
        self._reader.close()

    def tell(self, story: Spans) -> None:
        """Have the numbers be those of a story."""
        if story is not self._counted:
            self._counted, self._names = story, {}
            for one in (self._over, self._plans, self._failures, self._calls, self._attempts, self._durations):
                one.clear()
        for span in story.ended():
            self.count(span)
        states = Counter(task.state for task in story.tasks.values() if task.ending is None)
        for state in TaskState:
            if state is not TaskState.OVER:
                self._tasks.labels(state.word).set(states[state])
        asked = Counter(question["who"] for question in story.questions.values())
        for who in ("a person", "a source of knowledge"):
            self._questions.labels(who).set(asked[who])
        self._hands.set(len(story.replay.hands.taken))
        last = story.last()
        self._last.set(last)
        self._lag.set(last - story.number)

    def count(self, span: Span) -> None:
        """Count a span that has ended."""
        told = span.attributes
        for event in span.events:
            if event.name == "failure":
                self._failures.labels(event.attributes["pnm.cause"]).inc()
        match span.kind:
            case "task":
                self._over.labels(told["pnm.code"]).inc()
            case "plan":
                self._plans.labels(told["pnm.follows"]).inc()
            case "call" if "pnm.outcome" in told:
                self._calls.labels(self._name(told["pnm.action"]), self._name(told["pnm.outcome"])).inc()
            case "attempt" if span.ended is not None:
                action = self._name(told["pnm.action"])
                self._attempts.labels(action, told["pnm.end"] or "not known").inc()
                self._durations.labels(action).observe(span.ended - span.began)
            case _:
                pass

    def _name(self, found: object) -> str:
        name = str(found)[:_LONG]
        if len(self._names) < _NAMES:
            self._names[name] = None
        return name if name in self._names else "others"
