"""A journal where operations people look: as traces at a collector, as numbers for Prometheus, and as an MCAP file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from unittest import mock

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from prometheus_client.parser import text_string_to_metric_families

from planner_bridge.explanations.history import JournalHistory
from planner_bridge.tasks.result import TASKS
from planner_bridge.view.follow import Reader
from planner_bridge.view.recording import messages
from planner_bridge.view.spans import Span, Spans, export
from pnm.errors import PnmError
from pnm.journal import journal as journal_module
from pnm.journal.resume import summaries
from pnm.journal.store import KeptJournal
from tests.support.e2e.command_line import pnm
from tests.support.e2e.page.journals import GrowingJournal
from tests.support.e2e.page.serving import asked, page_of
from tests.support.files import written
from tests.support.processes import Program
from tests.support.tasks.scenarios.random_deaths import run_deaths

ABOVE = {"plan": ("task", "attempt"), "call": ("plan",), "attempt": ("call",)}


def ended(journal: Path) -> list[Span]:
    reader = Reader[Spans](journal, tells=Spans)
    found = reader.now(Spans.ended)
    reader.close()
    return found


def test_the_spans_of_a_run_are_its_task_its_plans_its_calls_and_their_attempts(delivery: Path) -> None:
    spans, history = ended(delivery), JournalHistory.read(delivery)
    (task,), (summary,) = history.tasks.values(), summaries(delivery, TASKS)
    kinds = Counter(span.kind for span in spans)
    assert (kinds["task"], kinds["plan"], kinds["attempt"]) == (1, len(task.runs), len(history.attempts))
    (top,) = (span for span in spans if span.kind == "task")
    assert (top.trace, top.began, top.failed) == (task.accepted.wanted.id, summary.accepted.wall, "")
    assert top.ended is not None
    assert top.ended - top.began == pytest.approx(summary.seconds)
    assert [event.name for event in top.events if event.name != "state"] == ["replan", "forbidden", "replan"]
    (why,) = (event.attributes["pnm.calls"] for event in top.events if event.name == "forbidden")
    assert why == "move(r1, hall, kitchen)"
    failures = [event for span in spans if span.kind == "call" for event in span.events if event.name == "failure"]
    assert [event.attributes["pnm.observed"] for event in failures] == ["the way is blocked"] * 2
    for request, attempt in history.attempts.items():
        (span,) = (span for span in spans if span.attributes.get("pnm.request") == str(request))
        assert span.began - top.began == pytest.approx(attempt.sent - task.time, abs=1e-5)
        assert attempt.outcome is not None
        assert span.attributes["pnm.end"] == attempt.outcome.kind.value
    assert ended(delivery) == spans, "ids and times are those of the journal"


@pytest.mark.parametrize("number", [0, 4, 9, 12, 15, 18])  # where some tasks have ended, and several processes have written
def test_tasks_whose_processes_die_are_one_trace_each_whenever_it_is_looked(number: int, tmp_path: Path) -> None:
    run_deaths(number, tmp_path)
    spans, listed = ended(tmp_path / "journal"), summaries(tmp_path / "journal", TASKS)
    over = [summary.accepted.wanted.id for summary in listed if summary.ending]
    assert sorted(span.trace for span in spans if span.kind == "task") == sorted(over)
    by_id = {span.id: span for span in spans}
    assert len(by_id) == len(spans)
    for span in (one for one in spans if one.trace in over):
        assert span.ended is not None
        assert span.began <= span.ended
        if span.parent is not None:
            above = by_id[span.parent]
            assert above.kind in ABOVE[span.kind]
            assert above.trace == span.trace
            assert above.kind == "task" or above.began <= span.began
    growing = GrowingJournal(tmp_path / "journal", tmp_path / "growing.journal")
    reader, seen = Reader[Spans](growing.place, tells=Spans), list[Span]()
    for length in range(3, growing.longest + 7, 7):
        growing.grow(length)
        seen += reader.now(Spans.ended)
    at_once = ended(growing.place)
    assert [(span.id, span.began) for span in sorted(seen, key=lambda one: one.id)] == [
        (span.id, span.began) for span in sorted(at_once, key=lambda one: one.id)
    ]
    reader.close()
    growing.close()


WORLD = """
ask:
  domain: domain.yaml
  plan:
    - note: {operation: {LocalUpdate: [go_on, {PersonQuery: [go_on, {text: "The pump is hot. Go on?", answers: ["yes", "no"]}]}]}}
"""


def test_what_a_person_has_answered_is_an_event_of_the_plan(tmp_path: Path) -> None:
    written(tmp_path / "domain.yaml", "actions: {note: {type: kb_action}}")
    written(tmp_path / "plan.yaml", WORLD)
    done = pnm("run", "--plan", "plan.yaml", "--answer", "go_on=yes", "--journal", "run.journal", cwd=tmp_path)
    assert done.returncode == 0, done.output
    (answer,) = (
        event for span in ended(tmp_path / "run.journal") if span.kind == "plan" for event in span.events if event.name == "answer"
    )
    assert answer.attributes["pnm.answer"] == "yes"
    assert "The pump is hot. Go on?" in str(answer.attributes["pnm.question"])


def test_the_sdk_gets_spans_as_it_makes_them_itself(delivery: Path) -> None:
    exporter = InMemorySpanExporter()
    count = export(delivery, lambda spans: exporter.export(spans).name.removeprefix("SUCCESS"), follows=False)
    got = exporter.get_finished_spans()
    assert len(got) == count == len(ended(delivery))
    (top,) = (span for span in got if span.parent is None)
    assert {span.context.trace_id for span in got if span.context} == {top.context and top.context.trace_id}
    assert all(json.loads(span.to_json())["start_time"] <= json.loads(span.to_json())["end_time"] for span in got)
    exporter.shutdown()
    pauses = list[float]()
    with pytest.raises(PnmError, match="spans not sent: FAILURE"):
        export(delivery, lambda spans: exporter.export(spans).name, follows=False, pause=pauses.append)
    assert len(pauses) == 4, "it was tried again, and not for ever"


def test_a_followed_journal_is_sent_as_it_grows_and_nothing_twice(growing: GrowingJournal) -> None:
    sent, lengths = list[str](), list[int]()

    def send(spans: Sequence[ReadableSpan]) -> str:
        return sent.extend(span.name for span in spans) or ""  # type: ignore[func-returns-value]

    def pause(seconds: float) -> None:
        if growing.length == growing.longest:
            raise KeyboardInterrupt
        lengths.append(len(sent))
        growing.grow(min(growing.length + 20, growing.longest))

    growing.grow(10)
    with pytest.raises(KeyboardInterrupt):
        export(growing.place, send, follows=True, pause=pause)
    assert sorted(sent) == sorted(span.name for span in ended(growing.place))
    assert any(before < after < len(sent) for before, after in pairwise(lengths)), "not all came at the end"


def test_all_is_sent_of_a_journal_whose_first_segments_nobody_shows_any_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "_LONG", 1)
    run_deaths(12, tmp_path)
    exporter = InMemorySpanExporter()
    export(tmp_path / "journal", lambda spans: exporter.export(spans).name.removeprefix("SUCCESS"), follows=False)
    traces = {span.context.trace_id for span in exporter.get_finished_spans() if span.context}
    assert traces == {summary.accepted.wanted.id.int for summary in summaries(tmp_path / "journal", TASKS)}


COLLECTOR = """
import json, sys
from http.server import BaseHTTPRequestHandler, HTTPServer
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest, ExportTraceServiceResponse

class Collector(BaseHTTPRequestHandler):
    def do_POST(self):
        body = ExportTraceServiceRequest.FromString(self.rfile.read(int(self.headers["content-length"])))
        for group in body.resource_spans:
            for one in group.scope_spans:
                for span in one.spans:
                    print(json.dumps([self.path, span.trace_id.hex(), span.span_id.hex(), span.parent_span_id.hex(), span.name,
                                      [event.name for event in span.events], span.status.code]), flush=True)
        self.send_response(200)
        self.end_headers()
        self.wfile.write(ExportTraceServiceResponse().SerializeToString())
    def log_message(self, *_):
        pass

server = HTTPServer(("127.0.0.1", 0), Collector)
print("ready", server.server_port, flush=True)
server.serve_forever()
"""


@pytest.fixture
def collector(tmp_path: Path) -> Iterator[Program]:
    program = Program([str(written(tmp_path / "collector.py", COLLECTOR))], {})
    yield program.ready()
    program.close()


def test_a_collector_in_another_process_gets_the_trace(delivery: Path, collector: Program) -> None:
    url = f"http://127.0.0.1:{collector.out[0].split()[1]}"
    told = pnm("telemetry", str(delivery), "--otlp", url)
    assert told.returncode == 0, told.stderr
    spans = ended(delivery)
    assert f"{len(spans)} spans sent to 127.0.0.1" in told.stderr
    collector.until(lambda: len(collector.out) > len(spans))
    got = {line[2]: line for line in map(json.loads, collector.out[1:])}
    assert {line[0] for line in got.values()} == {"/v1/traces"}
    assert {line[1] for line in got.values()} == {spans[0].trace.hex}
    for span in spans:
        _, _, _, parent, name, events, status = got[f"{span.id:016x}"]
        assert (parent, name) == ("" if span.parent is None else f"{span.parent:016x}", span.name)
        assert (events, status) == ([event.name for event in span.events], 2 if span.failed else 1)


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (("--otlp", "http://127.0.0.1:9"), 1, "spans not sent: 127.0.0.1, port 9: Connection refused"),
        (("--otlp", "http://nowhere.invalid:4318"), 1, "spans not sent: nowhere.invalid, port 4318: "),
        (("--otlp", "localhost"), 2, "expected the URL of a collector, such as http://localhost:4318"),
        (("--otlp", "http://[::1"), 2, "such as http://localhost:4318: Invalid IPv6 URL"),
        (("--otlp", "http://localhost:99999"), 2, "expected the URL of a collector"),
        ((), 2, "expected --otlp URL, with --follow or without, or --mcap FILE"),
        (("--mcap", "x.mcap", "--follow"), 2, "expected --otlp URL, with --follow or without, or --mcap FILE"),
        (("--mcap", "nowhere/x.mcap"), 2, "there is no folder nowhere"),
    ],
)
def test_what_cannot_be_sent_or_written_is_said(delivery: Path, arguments: tuple[str, ...], status: int, said: str) -> None:
    told = pnm("telemetry", str(delivery), *arguments)
    assert (told.returncode, said in told.stderr) == (status, True), told.stderr


def test_the_numbers_of_a_journal_are_those_of_its_history(delivery: Path) -> None:
    with page_of(delivery) as url:
        for _ in range(2):  # what was counted is not counted again
            status, headers, text = asked(url, "/metrics")
            assert (status, headers["content-type"].partition(";")[0]) == (200, "text/plain")
        assert asked(url, "/metrics", Host="evil.example")[0] == 421
        assert asked(url, "/metrics", Origin="http://evil.example")[0] == 403
    numbers = {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
    history = JournalHistory.read(delivery)
    ends = Counter((attempt.action.name, attempt.outcome.kind.value) for attempt in history.attempts.values() if attempt.outcome)
    assert {key[1:]: value for key, value in numbers.items() if key[0] == "pnm_attempts_total"} == ends
    assert numbers["pnm_tasks_over_total", "goal_reached"] == 1
    assert (numbers["pnm_plans_total", "first"], numbers["pnm_plans_total", "replan"]) == (1, 2)
    assert numbers["pnm_failures_total", "aborted"] == 2
    assert numbers["pnm_calls_total", "move", "aborted"] == 2
    moves = [one for one in history.attempts.values() if one.action.name == "move"]
    assert numbers["pnm_attempt_seconds_count", "move"] == len(moves)
    assert numbers["pnm_attempt_seconds_sum", "move"] == pytest.approx(sum((one.ended or 0.0) - one.sent for one in moves))
    assert (numbers["pnm_journal_last_record",], numbers["pnm_journal_lag_records",]) == (history.number, 0)
    assert (numbers["pnm_tasks", "running"], numbers["pnm_open_questions", "a person"], numbers["pnm_in_hands",]) == (0, 0, 0)


def test_numbers_count_on_over_segments_that_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "_LONG", 1)
    run_deaths(12, tmp_path)
    with page_of(tmp_path / "journal") as url:
        text = asked(url, "/metrics")[2]
    families = {one.name: one for one in text_string_to_metric_families(text)}
    listed = Counter(summary.ending.code.word for summary in summaries(tmp_path / "journal", TASKS) if summary.ending)
    assert {sample.labels["code"]: sample.value for sample in families["pnm_tasks_over"].samples if sample.name.endswith("total")} == listed


def test_a_journal_as_mcap_is_read_by_others(delivery: Path, tmp_path: Path) -> None:
    told = pnm("telemetry", str(delivery), "--mcap", str(tmp_path / "run.mcap"))
    assert told.returncode == 0, told.stderr
    history = JournalHistory.read(delivery)
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == {"/pnm/log", "/pnm/tasks", "/pnm/requests"}
        messages = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    log = [message for topic, message in messages if topic == "/pnm/log"]
    assert [one.line for one in log] == [*range(1, history.number + 1)]
    assert sum(one.level == 40 for one in log) > 0
    states = [message.state for topic, message in messages if topic == "/pnm/tasks"]
    assert (states[0], states[-1]) == ("queued", "goal_reached")
    ends = Counter(message.state for topic, message in messages if topic == "/pnm/requests")
    assert ends["sent"] == len(history.attempts)
    assert ends["succeeded"] + ends["aborted"] == len(history.attempts)
    layout = json.loads((tmp_path / "run.mcap.layout.json").read_text())
    shown = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert '/pnm/requests{robot=="r1"}.action' in shown
    assert [one for one in json.dumps(layout["layout"]).split('"') if "!" in one] == [*layout["configById"]]
    assert pnm("telemetry", str(delivery), "--mcap", str(tmp_path / "run.mcap")).returncode == 2, "nothing is overwritten"


@pytest.mark.parametrize("number", [0, 12])
def test_a_recording_says_what_became_of_every_task_and_every_request_and_says_it_once(number: int, tmp_path: Path) -> None:
    run_deaths(number, tmp_path)
    history, said = JournalHistory.read(tmp_path / "journal"), dict[str, object]()
    with closing(KeptJournal(tmp_path / "journal")) as kept:
        for _, _, fields in (one for one in messages(kept) if one.topic != "log"):
            now = fields["state"], fields.get("reason"), fields.get("message")
            assert said.get(fields["id"]) != now
            said[fields["id"]] = now
    for id, task in history.tasks.items():
        assert said[str(id)] == (task.ending.code.word if task.ending else task.state.word, task.reason, None)
    for id, one in history.attempts.items():
        state = one.outcome.kind.value if one.outcome else "sent" if one.accepted is None else "accepted"
        assert said[str(id)] == (state, None, one.feedback if state in ("sent", "accepted") else mock.ANY)
